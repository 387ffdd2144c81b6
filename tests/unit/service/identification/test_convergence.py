"""How an iterative fit ended is asked."""

import numpy as np
import pytest
from scipy.optimize import least_squares

from service.identification.model.least_squares import converged, finite, unsettled
from service.model.errors import BadInput


def rosenbrock(x: np.ndarray) -> np.ndarray:
    return np.array([10 * (x[1] - x[0] ** 2), 1 - x[0]])


def test_a_minimum_passes() -> None:
    converged(least_squares(rosenbrock, [-1.2, 1.0], method="lm"), "joint_1", "a valley")


def test_a_search_that_was_cut_short_is_refused() -> None:
    with pytest.raises(BadInput, match=r"^joint_1: the fit of a valley did not converge: The maximum number"):
        converged(least_squares(rosenbrock, [-1.2, 1.0], max_nfev=3), "joint_1", "a valley")


def test_what_is_no_number_is_refused() -> None:
    found = least_squares(rosenbrock, [-1.2, 1.0], method="lm")
    found.cost = np.nan
    with pytest.raises(BadInput, match=r"^joint_1: the fit of a valley has no finite residual"):
        converged(found, "joint_1", "a valley")


def test_a_start_that_is_no_number_is_refused_with_its_place() -> None:
    finite(np.ones(3), "joint_1", "a valley")
    with pytest.raises(BadInput, match=r"^joint_1: 2 of 3 values of a valley are not finite, the first is number 1"):
        finite(np.array([1.0, np.nan, np.inf]), "joint_1", "a valley")


def test_noise_that_still_changes_is_worth_a_warning() -> None:
    assert unsettled(0.01) is None
    assert unsettled(0.2) == "its noise still changes by 20 % in the last round; limit 5 %"
