"""The set-points of a streamed sweep as a drive takes them: velocities, or positions that the host integrates. Pure."""

from typing import Protocol

import numpy as np

from drivers.canopen.units import Codec
from drivers.cia402.waveform import set_point
from drivers.ports import SweepCommand

SUBSTEPS = 8  # of a cycle when integrating: exact to 10^-4 of an amplitude up to 5 Hz at 8 ms


class SetPoints(Protocol):
    """Targets in drive units, one a cycle. The target sent before SYNC k is reached one period later."""

    mode_bits: int
    """Of the controlword while the axis follows them."""

    def planned(self, number: int) -> int:
        """Of this cycle as the sweep has it; the last one for ever after."""
        ...

    def velocity(self, number: int) -> int:
        """Its velocity in drive units, from where a ramp down begins."""
        ...

    def ramped(self, number: int, velocity: int) -> int:
        """The target that leads on from cycle `number` at this velocity, in drive units; once a cycle."""
        ...


class Velocities:
    """60FFh."""

    mode_bits = 0

    def __init__(self, codec: Codec, command: SweepCommand, last: int, period: float) -> None:
        """`last` is the number of the last sample; `period` s."""
        wave = set_point(command, np.arange(1, last + 1, dtype=float) * period)
        self._targets = [codec.raw_velocity(velocity) for velocity in (*wave, 0.0)]

    def planned(self, number: int) -> int:
        return self._targets[min(number, len(self._targets) - 1)]

    velocity = planned

    def ramped(self, number: int, velocity: int) -> int:
        return velocity


class Positions:
    """607Ah or 60C1h: where the velocities lead to from `start`, drive units."""

    def __init__(
        self, codec: Codec, command: SweepCommand, last: int, period: float, start: int, mode_bits: int
    ) -> None:
        self.mode_bits = mode_bits
        self._velocities = Velocities(codec, command, last, period)
        fine = set_point(command, np.arange(last * SUBSTEPS + 1, dtype=float) * (period / SUBSTEPS))
        travelled = np.concatenate([[0.0], np.cumsum((fine[1:] + fine[:-1]) * (period / SUBSTEPS / 2))])[::SUBSTEPS]
        begin = float(codec.position(start))
        targets = [codec.raw_position(begin + float(each)) for each in travelled[1:]]
        self._targets = [*targets, targets[-1]]
        self._step = abs(codec.velocity_unit * codec.increments) * period  # position units of one velocity unit a cycle
        self._place: float | None = None  # once the ramp has begun

    def planned(self, number: int) -> int:
        return self._targets[min(number, len(self._targets) - 1)]

    def velocity(self, number: int) -> int:
        return self._velocities.planned(number)

    def ramped(self, number: int, velocity: int) -> int:
        if self._place is None:
            self._place = float(self.planned(max(0, number - 1)))
        self._place += velocity * self._step
        return round(self._place)
