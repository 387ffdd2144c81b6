"""A foreign drive's units and limits against rev, rev/s and N m of the motor, as its dictionary has them just now."""

from dataclasses import dataclass
from math import inf

from simulator.drive.dictionary import Abort, AbortCode
from simulator.foreign.dictionary import ForeignDictionary
from simulator.foreign.makers import Scaling

_REVOLUTIONS, _INCREMENTS = 0xB4, 0xB5  # numerators of 60A9h (CiA 303-2)
_SECONDS = {0x03: 1.0, 0x47: 60.0}
_DEGREES = 360_000.0  # 10^-3 degrees in a turn
_PER_MILLE = 1000


@dataclass(frozen=True, slots=True)
class Plate:
    """Motor and gear behind a drive; motor side: N m, N m/A, rev/s, rev. The window is that of the joint."""

    gear_ratio: float  # motor revolutions per joint revolution
    rated_torque: float
    most_torque: float
    torque_constant: float
    most_speed: float
    window: tuple[float, float]


class Units:
    """A view of one dictionary."""

    def __init__(self, dictionary: ForeignDictionary, plate: Plate) -> None:
        self._dictionary = dictionary
        self._maker = dictionary.maker
        self.plate = plate
        if (0x60A9, 0) in dictionary:
            dictionary.on_download((0x60A9, 0), self._check_velocity_unit)

    @property
    def position(self) -> float:
        """Units in a motor revolution."""
        match self._maker.scaling:
            case Scaling.RESOLUTION:
                return self._ratio(0x608F) / self._ratio(0x6091)
            case Scaling.ENCODER:
                return float(self._dictionary[0x3000, 5])
            case Scaling.FEED:
                return self._maker.increments * self._ratio(0x6092) / (self._ratio(0x608F) * self._ratio(0x6091))
            case Scaling.FACTORS:
                return self._maker.increments / self._ratio(0x6093)
            case Scaling.JOINT:
                return _DEGREES / self.plate.gear_ratio

    @property
    def velocity(self) -> float:
        """Units in 1 rev/s of the motor."""
        d = self._dictionary
        if (0x60A9, 0) in d:
            return self._of_code(d[0x60A9, 0])
        if self._maker.scaling is Scaling.FACTORS:
            return self._maker.increments / self._ratio(0x6094)
        return self.position

    @property
    def acceleration(self) -> float:
        """Units in 1 rev/s^2 of the motor."""
        return 60.0 if self._maker.acceleration_in_rpm else abs(self.velocity)

    @property
    def motor_speed(self) -> float:
        """Units of 6080h in 1 rev/s."""
        return 60.0 if self._maker.motor_speed_in_rpm else abs(self.velocity)

    @property
    def rated_torque(self) -> float:
        """What 1000 in 6077h means, N m: 6076h, or the rated current 6075h where there is none, or the motor's."""
        d = self._dictionary
        if (0x6076, 0) in d:
            return d[0x6076, 0] * self._maker.torque_unit or self.plate.rated_torque
        if (0x6075, 0) in d:
            return d[0x6075, 0] * 1e-3 * self.plate.torque_constant or self.plate.rated_torque
        return self.plate.rated_torque

    # Limits

    @property
    def torque_limit(self) -> float:
        """Least of motor, 6072h and 6073h, N m."""
        d, limit = self._dictionary, self.plate.most_torque
        if (0x6072, 0) in d:
            limit = min(limit, d[0x6072, 0] / _PER_MILLE * self.rated_torque)
        if (0x6073, 0) in d:
            rated = d[0x6075, 0] * 1e-3 * self.plate.torque_constant if (0x6075, 0) in d else self.rated_torque
            limit = min(limit, d[0x6073, 0] / _PER_MILLE * rated)
        return limit

    @property
    def speed_limit(self) -> float:
        """Of every mode: least of motor and 6080h, rev/s."""
        return min(self.plate.most_speed, self._dictionary.get(0x6080, 0, inf) / self.motor_speed)

    @property
    def profile_limit(self) -> float:
        """Of the profile modes: 607Fh as well, rev/s."""
        return min(self.speed_limit, self._dictionary.get(0x607F, 0, inf) / abs(self.velocity))

    @property
    def window(self) -> tuple[float, float]:
        """607Dh, rev; without end where there is none, or where it is empty (so it is switched off)."""
        d = self._dictionary
        low, high = d.get(0x607D, 1), d.get(0x607D, 2)
        if low >= high:
            return -inf, inf
        ends = sorted((low / self.position, high / self.position))
        return ends[0], ends[1]

    @property
    def following_window(self) -> float:
        """6065h, rev; 0 and FFFFFFFFh switch it off, and so does its absence."""
        told = self._dictionary.get(0x6065)
        return inf if told in (0, 0xFFFFFFFF) else told / abs(self.position)

    def ramp(self, index: int) -> float:
        """6083h, 6084h or 6085h, rev/s^2; where it is missing, the first of them that is there."""
        d = self._dictionary
        for candidate in (index, 0x6084, 0x6083):
            if (candidate, 0) in d:
                return max(d[candidate, 0], 1) / self.acceleration
        return self.plate.most_speed / 0.2  # nothing tells: from full speed in a fifth of a second

    def _ratio(self, index: int) -> float:
        """Sub 1 over sub 2 of a factor; 1 where the drive has none. A zero in it counts as 1."""
        d = self._dictionary
        return (d.get(index, 1, 1) or 1) / (d.get(index, 2, 1) or 1)

    def _of_code(self, code: int) -> float:
        prefix = (code >> 24) - (256 if code >> 31 else 0)
        numerator = self.position if code >> 16 & 0xFF == _INCREMENTS else 1.0
        return numerator * _SECONDS[code >> 8 & 0xFF] * 10.0**-prefix

    def _check_velocity_unit(self, code: int) -> None:
        """Powers of ten of the unit that the drive has anyway: the numerator and the time are fixed."""
        prefix = (code >> 24) - (256 if code >> 31 else 0)
        if (code ^ self._dictionary[0x60A9, 0]) & 0xFFFFFF or not -6 <= prefix <= 0:
            raise Abort(AbortCode.VALUE)


def nameplate(units: Units, dictionary: ForeignDictionary) -> dict[tuple[int, int], int]:
    """What a commissioner wrote into the drive for this motor, as far as it has objects for it."""
    plate, maker = units.plate, dictionary.maker
    position, velocity, acceleration = units.position, abs(units.velocity), units.acceleration
    ends = sorted((round(plate.window[0] * position), round(plate.window[1] * position)))
    values = {
        (0x6065, 0): round(abs(position) / 2),
        (0x6066, 0): 0,
        (0x6072, 0): round(_PER_MILLE * plate.most_torque / plate.rated_torque),
        (0x6073, 0): round(_PER_MILLE * plate.most_torque / plate.rated_torque),
        (0x6075, 0): round(plate.rated_torque / plate.torque_constant * 1e3),
        (0x6076, 0): round(plate.rated_torque / maker.torque_unit),
        (0x607D, 1): ends[0],
        (0x607D, 2): ends[1],
        (0x607F, 0): round(plate.most_speed * velocity),
        (0x6080, 0): round(plate.most_speed * units.motor_speed),
        (0x6081, 0): round(plate.most_speed * velocity / 10),
        **{(index, 0): round(plate.most_speed / 0.5 * acceleration) for index in (0x6083, 0x6084)},
        (0x6085, 0): round(plate.most_speed / 0.2 * acceleration),
    }
    return {key: value for key, value in values.items() if key in dictionary}
