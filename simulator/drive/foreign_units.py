"""Units and limits of a foreign drive in rev, rev/s and N m of the motor, from the present dictionary."""

from dataclasses import dataclass
from math import inf

from simulator.drive.dictionary import AbortCode, ObjectDictionary, SdoAbort, power_of_ten
from simulator.drive.limits import PER_MILLE
from simulator.drive.makers import Scaling


@dataclass(frozen=True, slots=True)
class MotorPlate:
    """Motor and gear of a drive; motor side: N m, N m/A, rev/s, rev. The window is that of the joint."""

    gear_ratio: float  # motor revolutions per joint revolution
    rated_torque: float
    most_torque: float
    torque_constant: float
    most_speed: float
    window: tuple[float, float]


class DriveUnits:
    """A view of one dictionary."""

    def __init__(self, dictionary: ObjectDictionary, plate: MotorPlate) -> None:
        self._dictionary = dictionary
        self._maker = dictionary.maker
        self.plate = plate
        if (0x60A9, 0) in dictionary:
            dictionary.on_download((0x60A9, 0), self._check_velocity_unit)

    @property
    def position(self) -> float:
        """Units per motor revolution."""
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
                return 360_000.0 / self.plate.gear_ratio  # 10^-3 degrees

    @property
    def velocity(self) -> float:
        """Units per 1 rev/s of the motor."""
        d = self._dictionary
        if (0x60A9, 0) in d:
            return self._of_code(d[0x60A9, 0])
        if self._maker.scaling is Scaling.FACTORS:
            return self._maker.increments / self._ratio(0x6094)
        return self.position

    @property
    def acceleration(self) -> float:
        """Units per 1 rev/s^2 of the motor."""
        return 60.0 if self._maker.acceleration_in_rpm else abs(self.velocity)

    @property
    def motor_speed(self) -> float:
        """Units of 6080h per 1 rev/s."""
        return 60.0 if self._maker.motor_speed_in_rpm else abs(self.velocity)

    @property
    def rated_torque(self) -> float:
        """Torque of 1000 in 6077h, N m: 6076h, or the rated current 6075h if it is missing, or that of the motor."""
        d = self._dictionary
        if (0x6076, 0) in d:
            return d[0x6076, 0] * self._maker.torque_unit or self.plate.rated_torque
        if (0x6075, 0) in d:
            return d[0x6075, 0] * 1e-3 * self.plate.torque_constant or self.plate.rated_torque
        return self.plate.rated_torque

    # Limits

    @property
    def torque_limit(self) -> float:
        """Minimum of motor, 6072h and 6073h, N m."""
        d, limit = self._dictionary, self.plate.most_torque
        if (0x6072, 0) in d:
            limit = min(limit, d[0x6072, 0] / PER_MILLE * self.rated_torque)
        if (0x6073, 0) in d:
            rated = d[0x6075, 0] * 1e-3 * self.plate.torque_constant if (0x6075, 0) in d else self.rated_torque
            limit = min(limit, d[0x6073, 0] / PER_MILLE * rated)
        return limit

    @property
    def speed_limit(self) -> float:
        """For all modes: minimum of motor and 6080h, rev/s."""
        return min(self.plate.most_speed, self._dictionary.get(0x6080, 0, inf) / self.motor_speed)

    @property
    def profile_limit(self) -> float:
        """For the profile modes: also 607Fh, rev/s."""
        return min(self.speed_limit, self._dictionary.get(0x607F, 0, inf) / abs(self.velocity))

    @property
    def window(self) -> tuple[float, float]:
        """607Dh, rev; unlimited if it is missing or empty (which disables it)."""
        d = self._dictionary
        low, high = d.get(0x607D, 1), d.get(0x607D, 2)
        if low >= high:
            return -inf, inf
        ends = sorted((low / self.position, high / self.position))
        return ends[0], ends[1]

    @property
    def following_window(self) -> float:
        """6065h, rev; disabled by 0, by FFFFFFFFh, or if it is missing."""
        limit = self._dictionary.get(0x6065)
        return inf if limit in (0, 0xFFFFFFFF) else limit / abs(self.position)

    def ramp(self, index: int) -> float:
        """6083h, 6084h or 6085h, rev/s^2; if it is missing, the first of them that exists."""
        d = self._dictionary
        for candidate in (index, 0x6084, 0x6083):
            if (candidate, 0) in d:
                return max(d[candidate, 0], 1) / self.acceleration
        return self.plate.most_speed / 0.2  # no source: from full speed in 0.2 s

    def _ratio(self, index: int) -> float:
        """Sub-index 1 over sub-index 2 of a factor; 1 if the drive has none. A zero in it counts as 1."""
        d = self._dictionary
        return (d.get(index, 1, 1) or 1) / (d.get(index, 2, 1) or 1)

    def _of_code(self, code: int) -> float:
        numerator = self.position if code >> 16 & 0xFF == 0xB5 else 1.0  # increments, else revolutions (CiA 303-2)
        return numerator * {0x03: 1.0, 0x47: 60.0}[code >> 8 & 0xFF] * 10.0 ** -power_of_ten(code)

    def _check_velocity_unit(self, code: int) -> None:
        """Only the power of ten of the drive's own unit may change; numerator and time are fixed."""
        if (code ^ self._dictionary[0x60A9, 0]) & 0xFFFFFF or not -6 <= power_of_ten(code) <= 0:
            raise SdoAbort(AbortCode.VALUE)


def nameplate(units: DriveUnits, dictionary: ObjectDictionary) -> dict[tuple[int, int], int]:
    """Values commissioned in the drive for this motor, if it has objects for them."""
    plate, maker = units.plate, dictionary.maker
    position, velocity, acceleration = units.position, abs(units.velocity), units.acceleration
    ends = sorted((round(plate.window[0] * position), round(plate.window[1] * position)))
    values = {
        (0x6065, 0): round(abs(position) / 2),
        (0x6066, 0): 0,
        (0x6072, 0): round(PER_MILLE * plate.most_torque / plate.rated_torque),
        (0x6073, 0): round(PER_MILLE * plate.most_torque / plate.rated_torque),
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
