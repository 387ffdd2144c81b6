"""Actual values of the drive: 6064h, 606Ch and 6077h, means over the last cycles."""

from simulator.drive.dictionary import Dictionary
from simulator.drive.limits import Limits
from simulator.drive.measuring import Samples
from simulator.drive.units import INCREMENTS, PER_MILLE, clamp


class ActualValues:
    """Writes them into the dictionary."""

    def __init__(self, dictionary: Dictionary, limits: Limits) -> None:
        self._dictionary = dictionary
        self._limits = limits

    def stand(self, position: float) -> None:
        """No torque, no speed, at `position`, rev."""
        d = self._dictionary
        d[0x6064, 0] = clamp(position * INCREMENTS, 32)
        d[0x606C, 0] = d[0x6077, 0] = 0

    def update(self, samples: Samples) -> None:
        """Values of an energised axis."""
        d = self._dictionary
        d[0x6064, 0] = clamp(float(samples.position.mean()) * INCREMENTS, 32)
        d[0x606C, 0] = clamp(float(samples.speed.mean()) * self._limits.speed_unit, 32)
        d[0x6077, 0] = clamp(float(samples.torque.mean()) * PER_MILLE * PER_MILLE / max(d[0x6076, 0], 1), 16)

    def glitch(self, revolutions: float, span: float) -> None:
        """The encoder was wrong by `revolutions` for the `span`, s, of the last values."""
        d = self._dictionary
        d[0x6064, 0] = clamp(d[0x6064, 0] + revolutions * INCREMENTS, 32)
        d[0x606C, 0] = clamp(d[0x606C, 0] + revolutions / span * self._limits.speed_unit, 32)
