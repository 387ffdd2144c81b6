"""The drive of another maker: its modes of operation (CiA 402-2), faults and actual values over an exact dictionary.

Based on CiA 301, CiA 402 and the makers' published firmware documentation (`makers`), not on the code of any host: a
wrong assumption of a host about a drive is detected here. Units, modes and option codes come from the file.

Inputs: objects written by the bus, and the samples of the last cycles. Outputs: `energised`, speed set-points, torque
added to that of the speed controller, and actual values. Positions in rev, speeds in rev/s, torque in N m of the motor.
"""

from dataclasses import dataclass
from math import copysign, inf

import numpy as np

from simulator.drive.dictionary import AbortCode, ObjectDictionary, SdoAbort, power_of_ten
from simulator.drive.limits import PER_MILLE
from simulator.drive.makers import Scaling
from simulator.drive.measuring import DriveSamples
from simulator.drive.power_drive import DriveState, FaultCode, Mode, PowerDrive
from simulator.waveform import Array, RampProfile, brake, travel


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


CYCLIC = (Mode.INTERPOLATED_POSITION, Mode.CYCLIC_POSITION, Mode.CYCLIC_VELOCITY)
"""Modes in which a host sends set-points with SYNC."""


def supported(modes: int, value: int) -> bool:
    """Whether 6502h `modes` includes the mode of 6060h `value`, and it moves an axis here; 0 is always included."""
    return value == 0 or (value in tuple(Mode) and bool(modes >> (value - 1) & 1))


class Guide:
    """Set-points of one energised axis. `command` is the last speed, `reference` the position."""

    def __init__(self, dictionary: ObjectDictionary, units: DriveUnits, cycle: float) -> None:
        self._dictionary = dictionary
        self._units = units
        self._cycle = cycle
        self.command = self.reference = 0.0
        self.start(Mode.NONE, 0.0)

    def start(self, mode: Mode, position: float) -> None:
        """Begin a mode from standstill at `position`. Targets keep the values written by the host."""
        self.mode = mode
        self.running = True  # interpolated position starts with bit 4 of the controlword
        self.halted = False
        self.limited = False  # a target was limited
        self.stopped = False  # braked by a command: targets are ignored until `start`, or until a halt ends
        self.hold(position)

    def hold(self, position: float) -> None:
        """Stand at `position` until a target commands a motion."""
        self.reference, self.command = position, 0.0
        self._motion: RampProfile | None = None
        self.ramping = False
        self._time = 0.0  # since the start of the motion
        self._origin = position  # of the motion
        self.target: float | None = None  # of the last move or interpolation
        self._left = 0  # remaining cycles of the interpolation

    # Commands

    def move(self, position: float, target: float, *, relative: bool) -> None:
        """Start a profile position move."""
        if relative:
            target += self.reference if self.target is None else self.target
        low, high = self._units.window
        self.target = min(max(target, low), high)
        self.limited = self.target != target
        self._origin = position if self.ramping else self.reference
        limit = min(self._units.profile_limit, self._dictionary.get(0x6081) / abs(self._units.velocity))
        if limit > 0.0:
            up, down = self._units.ramp(0x6083), self._units.ramp(0x6084)
            self._motion = travel(self.target - self._origin, self.command, limit, up, down)
            self._time, self.ramping, self.stopped = 0.0, False, False

    def ramp_down(self, deceleration: float) -> None:
        """Brake to standstill with `deceleration`, rev/s^2, in any mode."""
        self._motion, self._time, self.ramping = brake(self.command, deceleration), 0.0, True
        self.stopped = True

    # State

    @property
    def moving(self) -> bool:
        """Whether set-points differ from zero, or may do so in the next cycle."""
        return self._motion is not None or self.command != 0.0 or self._left > 0

    @property
    def ended(self) -> float | None:
        """Seconds since a ramp to standstill ended; None while it runs, or if there is none."""
        if self._motion is None or not self.ramping or self._time < self._motion.duration:
            return None
        return self._time - self._motion.duration

    @property
    def tracking(self) -> bool:
        """Whether the position is controlled."""
        return (
            self.mode in (Mode.PROFILE_POSITION, Mode.INTERPOLATED_POSITION, Mode.CYCLIC_POSITION) and not self.ramping
        )

    # Cycles

    def setpoints(self, cycles: int, position: float) -> Array:
        """Speeds at the end of each of the next cycles (cycles,), with the axis at `position` now."""
        limit = self._units.speed_limit
        if self._motion is not None:
            speeds = self._along(self._motion, cycles)
        elif self.stopped:
            self.command, speeds = 0.0, np.zeros(cycles)
        elif self.mode is Mode.CYCLIC_VELOCITY:
            speeds = self._interpolate_velocity(cycles)
        elif self.mode is Mode.PROFILE_VELOCITY:
            speeds = self._ramp_velocity(cycles)
        elif self.mode in CYCLIC and self.running:
            speeds = self._interpolate_position(cycles)
        else:
            self.command, speeds = 0.0, np.zeros(cycles)
        if self.tracking:
            speeds = speeds + 10.0 * (self.reference - position)  # 1/s, position controller
        return np.clip(speeds, -limit, limit)

    def finish(self) -> None:
        """End a move that has reached its end."""
        if self._motion is not None and not self.ramping and self._time >= self._motion.duration:
            self._motion = None

    def _along(self, motion: RampProfile, cycles: int) -> Array:
        times = self._time + np.arange(1, cycles + 1, dtype=np.float64) * self._cycle
        speeds = motion.velocity(times)
        self._time, self.command = float(times[-1]), float(speeds[-1])
        self.reference = self._origin + float(motion.position(times[-1:])[0])
        return speeds

    def _interpolate_velocity(self, cycles: int) -> Array:
        goal = self._velocity_goal(self._units.speed_limit)
        if goal != self.target:
            self.target, self._left = goal, self.period
        speeds = np.empty(cycles)
        for k in range(cycles):
            if self._left > 0:
                self.command += (goal - self.command) / self._left
                self._left -= 1
            speeds[k] = self.command
        return speeds

    def _ramp_velocity(self, cycles: int) -> Array:
        goal = 0.0 if self.halted else self._velocity_goal(self._units.profile_limit)
        speeds = np.empty(cycles)
        for k in range(cycles):
            slower = abs(goal) < abs(self.command) or goal * self.command < 0
            step = self._units.ramp(0x6084 if slower else 0x6083) * self._cycle
            self.command += min(max(goal - self.command, -step), step)
            speeds[k] = self.command
        return speeds

    def _interpolate_position(self, cycles: int) -> Array:
        d, cyclic = self._dictionary, self.mode is Mode.CYCLIC_POSITION
        key = (0x607A, 0) if cyclic else (0x60C1, 1)
        asked = (d[key] + (d.get(0x60B0) if cyclic else 0)) / self._units.position
        low, high = self._units.window
        goal = min(max(asked, low), high)
        self.limited = goal != asked
        if goal != self.target:
            self.target, self._left = goal, self.period
        ahead = d.get(0x60B1) / self._units.velocity if cyclic else 0.0
        speeds = np.empty(cycles)
        for k in range(cycles):
            way = (goal - self.reference) / self._left if self._left > 0 else 0.0
            self._left = max(self._left - 1, 0)
            self.reference += way
            speeds[k] = way / self._cycle + ahead
        limit = self._units.speed_limit
        self.command = min(max(float(speeds[-1]), -limit), limit)
        return speeds

    def _velocity_goal(self, limit: float) -> float:
        d = self._dictionary
        offset = d.get(0x60B1) if self.mode is Mode.CYCLIC_VELOCITY else 0
        asked = (d[0x60FF, 0] + offset) / self._units.velocity
        goal = min(max(asked, -limit), limit)
        self.limited = goal != asked
        return goal

    @property
    def period(self) -> int:
        """60C2h in cycles, at least 1: time in which a new set-point is reached."""
        d = self._dictionary
        return max(round(d.get(0x60C2, 1) * 10.0 ** d.get(0x60C2, 2, -3) / self._cycle), 1)


class ForeignAxis(PowerDrive):
    """One axis. The modes of a drive are the bits of its 6502h."""

    def __init__(self, dictionary: ObjectDictionary, plate: MotorPlate, cycle: float, *, can_move: bool) -> None:
        super().__init__(dictionary, cycle, can_move=can_move)
        self.units = DriveUnits(dictionary, plate)
        self.guide = Guide(dictionary, self.units, cycle)
        self.torque = 0.0
        dictionary.on_download((0x6060, 0), self._ask_mode)
        self.reset()

    @property
    def following(self) -> bool:
        """Whether set-points of a host move the axis: enabled in a cyclic mode, and not braking."""
        fed = self.mode in CYCLIC or self.mode is Mode.PROFILE_VELOCITY
        return self.state is DriveState.OPERATION_ENABLED and fed and not self.guide.stopped

    @property
    def braking(self) -> bool:
        return self.guide.ramping

    @property
    def moving(self) -> bool:
        """Whether a move, a ramp or a speed is commanded, or the axis has not yet come to rest."""
        return self.energised and (self.guide.moving or abs(self.speed) > self.standstill)

    @property
    def torque_limit(self) -> float:
        """Maximum torque of the drive, N m."""
        return min(self.units.torque_limit, self.disturbance.torque_cap * self.units.plate.rated_torque)

    # Cycles

    def setpoints(self, cycles: int) -> Array:
        """Speed set-points at the end of each of the next cycles (cycles,), rev/s."""
        return self.guide.setpoints(cycles, self.position) if self.energised else np.zeros(cycles)

    def injection(self, cycles: int) -> Array | None:
        """Torque offset 60B2h of the cyclic modes in the next cycles (cycles,), N m."""
        offset = self._dictionary.get(0x60B2) if self.following and self.mode in CYCLIC else 0
        return np.full(cycles, offset * 1e-3 * self.units.rated_torque) if offset else None

    def observe(self, samples: DriveSamples) -> None:
        self.position, self.speed = float(samples.position[-1]), float(samples.speed.mean())
        self.torque = float(samples.torque.mean())
        span = len(samples.speed) * self._cycle
        glitch, code = self.disturbance.take_glitch(0), self.disturbance.take_fault()
        off = 0.0 if glitch is None else glitch.revolutions
        self._show(samples, off, span)
        if abs(off) > self.units.following_window:
            code = FaultCode.ENCODER
        if code is None:
            code = self._supervise(span)
        if code is not None and self.energised:
            self.fail(code)
        self._finish()
        self.publish()

    def _supervise(self, span: float) -> int | None:
        if self.state is not DriveState.OPERATION_ENABLED or self.guide.ramping:
            return None
        command, units = self.guide.command, self.units
        lag = abs(self.guide.reference - self.position) if self.guide.tracking else 0.0
        self._lagging = self._lagging + span if lag > units.following_window else 0.0
        if self._lagging > self._dictionary.get(0x6066) * 1e-3:
            return FaultCode.FOLLOWING
        most = units.speed_limit + 0.1 * units.plate.most_speed
        ahead = self.position + copysign(command**2 / (2 * units.ramp(0x6085)), command)
        low, high = units.window
        if not self.guide.tracking and ((command > 0 and ahead > high) or (command < 0 and ahead < low)):
            return self._dictionary.maker.position_limit_code
        return FaultCode.SPEED_LIMIT if abs(self.speed) > most else None

    def _finish(self) -> None:
        self.guide.finish()
        since = self.guide.ended
        if since is not None and (abs(self.speed) < self.standstill or since > self.patience):
            self.guide.hold(self.position)
            if self._after is not None:
                self._release(self._after)
            elif self.state is DriveState.OPERATION_ENABLED and not self.guide.halted:
                self.guide.stopped = False
        if self.mode != self._asked and not self.moving:
            self._take_mode(self._asked)

    # As any power drive

    def _power_on(self) -> None:
        self._lagging = 0.0  # s outside the following window
        self.torque = 0.0
        self.mode = Mode.NONE
        self._take_mode(self._dictionary[0x6060, 0])

    def _begin(self, *, again: bool) -> None:
        del again
        self._lagging = 0.0
        self.guide.start(self.mode, self.position)

    def _ask_mode(self, value: int) -> None:
        if not supported(self._dictionary[0x6502, 0], value):
            if self._dictionary.maker.refuses_modes:
                raise SdoAbort(AbortCode.VALUE)
            return
        self._asked = Mode(value)
        if not self.moving:
            self._take_mode(value)
        self.publish()

    def _take_mode(self, value: int) -> None:
        self._asked = self.mode = Mode(value) if supported(self._dictionary[0x6502, 0], value) else Mode.NONE
        self.guide.start(self.mode, self.position)

    def _operate(self, before: int) -> None:
        now, guide = self._controlword, self.guide
        guide.halted = bool(now & 0x100)
        if before & ~now & 0x100 and not guide.ramping:
            guide.stopped = False
        if now & ~before & 0x100 and guide.moving and not guide.ramping and self.mode is not Mode.PROFILE_VELOCITY:
            self._brake(fast=self._dictionary[0x605D, 0] == 2, then=None)
        if self.mode is Mode.INTERPOLATED_POSITION:
            guide.running = bool(now & 0x10) and not guide.halted
        if self.mode is not Mode.PROFILE_POSITION:
            return
        if not now & 0x10:
            self._acknowledged = False
        elif not before & 0x10 and not guide.halted:
            target = self._dictionary[0x607A, 0] / self.units.position
            guide.move(self.position, target, relative=bool(now & 0x40))
            self._acknowledged = True

    def _ramp_down(self, *, fast: bool) -> None:
        self.guide.ramp_down(self.units.ramp(0x6085 if fast else 0x6084))

    def _stand(self) -> None:
        self.torque = 0.0
        self.guide.hold(self.position)

    # Actual values

    def publish(self) -> None:
        """Call it after any change of units as well."""
        self._dictionary.set_actual(0x6041, self._statusword())
        self._dictionary.set_actual(0x6061, int(self.mode))
        if not self.energised:
            self._dictionary.set_actual(0x6064, round(self.position * self.units.position))
            for index in (0x606C, 0x6077, 0x6078, 0x6074, 0x606B):
                self._dictionary.set_actual(index, 0)

    def _statusword(self) -> int:
        """6041h: the state, voltage (4), remote (9), target reached (10), limit (11) and the mode's 12 and 13."""
        guide, enabled, stands = (
            self.guide,
            self.state is DriveState.OPERATION_ENABLED,
            abs(self.speed) < self.standstill,
        )
        reached = self.state is DriveState.QUICK_STOP_ACTIVE and not guide.moving
        twelve = False
        if enabled:
            match self.mode:
                case Mode.PROFILE_POSITION:
                    arrived = stands and (guide.target is None or abs(guide.target - self.position) < 1e-3)
                    reached, twelve = not guide.moving and arrived, self._acknowledged
                case Mode.PROFILE_VELOCITY:
                    near = max(0.05 * abs(guide.command), self.standstill)
                    reached, twelve = not guide.limited and abs(self.speed - guide.command) < near, stands
                case Mode.INTERPOLATED_POSITION:
                    twelve = self.following and guide.running
                case Mode.CYCLIC_POSITION | Mode.CYCLIC_VELOCITY:
                    twelve = self.following
                case Mode.NONE:
                    pass
        bits = {
            0x0010: not self.emergency_stop,
            0x0200: True,
            0x0400: reached,
            0x0800: enabled and guide.limited,
            0x1000: twelve,
            0x2000: self.errors.code == FaultCode.FOLLOWING,
        }
        return int(self.state) | sum(bit for bit, on in bits.items() if on)

    def _show(self, samples: DriveSamples, glitch: float, span: float) -> None:
        """Position, speed, torque and current as means over the last cycles; the encoder is wrong by `glitch`, rev."""
        d, units, guide = self._dictionary, self.units, self.guide
        position = float(samples.position.mean()) + glitch
        speed = float(samples.speed.mean()) + glitch / span
        torque = float(samples.torque.mean())
        permille = round(torque / units.rated_torque * PER_MILLE)
        current = round(torque / units.plate.torque_constant / (d.get(0x6075) * 1e-3 or inf) * PER_MILLE)
        values = {
            0x6064: round(position * units.position),
            0x6063: round(position * d.maker.increments),
            0x6062: round(guide.reference * units.position),
            0x6069: round(speed * units.velocity),
            0x606C: round(speed * units.velocity),
            0x606B: round(guide.command * units.velocity),
            0x6074: permille,
            0x6077: permille,
            0x6078: current,
        }
        if guide.tracking:
            values[0x60F4] = round((guide.reference - position) * units.position)
        for index, value in values.items():
            d.set_actual(index, value)
