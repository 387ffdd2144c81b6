"""The fit of an axis is computed again when any of its inputs changed, and only then."""

from typing import cast

import numpy as np

from service.identification.axis.axis_estimate import AxisEstimate
from service.identification.estimates.estimate import KEPT, unchanged_or


class Fits:
    """Counts what is computed; a result of its own each time. What is kept outlives a test: each has its own inputs."""

    def __init__(self) -> None:
        self.inputs: list[tuple[float, ...]] = []

    def __call__(self, effort: np.ndarray, gain: float) -> AxisEstimate:
        self.inputs.append((*effort.tolist(), gain))
        return cast(AxisEstimate, object())


def test_equal_inputs_are_computed_once() -> None:
    fits = Fits()
    first = unchanged_or(fits.__call__, np.array([10.0, 20.0]), 3.0)
    assert unchanged_or(fits.__call__, np.array([10.0, 20.0]), 3.0) is first
    assert len(fits.inputs) == 1


def test_the_last_bit_of_an_input_counts() -> None:
    fits = Fits()
    first = unchanged_or(fits.__call__, np.array([1.0, 2.0]), 3.0)
    other = unchanged_or(fits.__call__, np.array([1.0, np.nextafter(2.0, 3.0)]), 3.0)
    third = unchanged_or(fits.__call__, np.array([1.0, 2.0]), np.nextafter(3.0, 4.0))
    assert len({id(first), id(other), id(third)}) == 3


def test_few_are_kept() -> None:
    fits = Fits()
    for number in range(KEPT + 1):
        unchanged_or(fits.__call__, np.array([float(number)]), 0.0)
    unchanged_or(fits.__call__, np.array([float(KEPT)]), 0.0)  # kept
    assert len(fits.inputs) == KEPT + 1
    unchanged_or(fits.__call__, np.array([0.0]), 0.0)  # the oldest is not
    assert len(fits.inputs) == KEPT + 2
