"""Sound bundles for the check of the data: cases of the second plant, whose data are sound whatever they hide.

CAD is off by up to 18 % in most of them, numbers have 32 bits, records end with their window in half, holds come first.
"""

from dataclasses import dataclass

from service.store.files.bundle import Bundle
from tests.numeric.second_plant.cases import Kind, case, make
from tests.numeric.second_plant.effects import CATALOGUE

HIDDEN = (None, *CATALOGUE)


@dataclass(frozen=True)
class Sound:
    """A sound bundle of one axis that was swept."""

    bundle: Bundle
    joint: str


def sound(number: int) -> Sound:
    """Nothing is hidden in the first, then each effect of the catalogue in turn."""
    name = HIDDEN[number % len(HIDDEN)]
    one = case(60, number, Kind.SINGLE, (name,)) if name else case(60, number, Kind.NONE, size="none")
    robot, joint, sweeps, _ = make(one, small=True)
    return Sound(Bundle(robot, sweeps), joint)
