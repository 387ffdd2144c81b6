"""Set-points of a streamed sweep in the form of the drive: velocities, or positions integrated by the host. Pure."""

from typing import Protocol

import numpy as np

from drivers.canopen.units import Codec
from drivers.cia402.waveform import set_point
from drivers.ports import SweepCommand

SUBSTEPS = 8  # integration steps per cycle: exact to 10^-4 of an amplitude up to 5 Hz at 8 ms


class SetPoints(Protocol):
    """Targets in drive units, one per cycle. The target sent before SYNC k is reached one period later."""

    mode_bits: int
    """Bits of the controlword while the axis follows the set-points."""

    def planned(self, number: int) -> int:
        """Target of this cycle of the sweep; the last target after its end."""
        ...

    def velocity(self, number: int) -> int:
        """Velocity of this cycle in drive units, from which a ramp to standstill begins."""
        ...

    def ramped(self, number: int, velocity: int) -> int:
        """Target that continues from cycle `number` at this velocity, in drive units; call once per cycle."""
        ...


class Velocities:
    """Targets for 60FFh."""

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
    """Targets for 607Ah or 60C1h: the velocities integrated from `start`, drive units."""

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
        self._step = abs(codec.velocity_unit * codec.increments) * period  # position units per cycle and velocity unit
        self._place: float | None = None  # position during the ramp

    def planned(self, number: int) -> int:
        return self._targets[min(number, len(self._targets) - 1)]

    def velocity(self, number: int) -> int:
        return self._velocities.planned(number)

    def ramped(self, number: int, velocity: int) -> int:
        if self._place is None:
            self._place = float(self.planned(max(0, number - 1)))
        self._place += velocity * self._step
        return round(self._place)
