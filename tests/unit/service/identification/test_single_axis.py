"""Sweeps of axes that moved at once never pass for sweeps of single axes."""

from typing import Any

import numpy as np
import pytest

from service.identification.estimates.estimate import identify
from service.identification.estimation import estimate_document
from service.identification.spectra.frequency_response import Spectrum, spectrum
from service.model.errors import BadInput
from service.model.recording import Sine
from service.model.robot import Robot
from tests.formula_sweep import Turning, by_formula


def free(robot: Robot, axis: str, **fields: Any) -> Spectrum:
    """8 s to and fro, for which J = 250 kg m^2."""
    sines = (Sine(frequency=0.4, amplitude=0.3), Sine(frequency=1.1, amplitude=0.1))

    def effort(m: Turning) -> np.ndarray:
        return 250.0 * m.acceleration + 90 * m.velocity + np.random.default_rng(1).normal(0, 2.0, len(m.time))

    told: dict[str, Any] = {"id": axis, "axis": axis, "pose": (0.0, 0.0), "excitation": "trajectory", "period": None}
    return spectrum(robot, by_formula(effort, 8.0, sines, **told | fields))


def test_records_of_two_axes_at_once_are_refused(robot: Robot) -> None:
    both = [free(robot, "lift", started_at=20.0), free(robot, "swing", started_at=20.0)]
    with pytest.raises(BadInput, match="sweep swing: swing moved while lift did in sweep lift"):
        identify(robot, both)
    with pytest.raises(BadInput, match="correct started_at"):
        estimate_document(robot, both)


def test_an_overlap_is_enough_and_one_after_the_other_is_none(robot: Robot) -> None:
    lift = free(robot, "lift", started_at=20.0)
    with pytest.raises(BadInput, match="started_at 27 and 20 s"):
        identify(robot, [lift, free(robot, "swing", started_at=27.0)])
    for told in ({"started_at": 28.0}, {"started_at": 20.0, "pose": (0.0, 0.5)}):
        assert len(identify(robot, [lift, free(robot, "swing", **told)]).axes) == 2


def test_a_block_that_says_how_many_axes_it_moved_is_believed(robot: Robot) -> None:
    """The other axis may be missing from the bundle."""
    with pytest.raises(BadInput, match="sweep swing: its block 'trajectory 3 of 2 axes' moved several axes at once"):
        identify(robot, [free(robot, "swing", block="trajectory 3 of 2 axes")])
    assert identify(robot, [free(robot, "swing", block="trajectory 3 of 1 axes")]).axes
