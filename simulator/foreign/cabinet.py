"""A cabinet of foreign drives on a CAN bus, one node per axis: one machine, one clock. Frames and times in, frames out.

While set-points come with SYNC, the bus is the clock: each SYNC advances the machine by its period (1006h, else
60C2h, else as measured). Otherwise, and if SYNC is missing, real time is the clock, multiplied by `speed_factor`
during motion in profile position. Without any torque the machine stands.
"""

from collections.abc import Callable, Mapping
from math import inf, nan, tau
from pathlib import Path

import numpy as np

from simulator.cabinet import joint_limits
from simulator.canopen.node import Frame
from simulator.drive.measuring import Samples
from simulator.foreign.axis import Axis
from simulator.foreign.modes import Mode
from simulator.foreign.node import ForeignNode
from simulator.foreign.units import Plate
from simulator.machine import AxisInfo, Machine
from simulator.scenario import ScenarioError

_CHUNK = (4, 16)  # cycles per call during motion
_HOLDING_CHUNK = 20  # cycles per call at standstill
_BACKLOG = 4  # chunks that may be caught up after the computer was busy
_SYNC_LOST = 5.0  # s after the last SYNC, from which the machine continues in real time, as a real axis does
_CURRENT = 10.0  # A at rated torque, for every motor


class ForeignCabinet:
    """Node ids 1, 2, ... in the order of the machine's joints; `files`: the EDS or DCF of each joint's drive.

    Raises ScenarioError for a joint without a file, or a file of another kind.
    """

    def __init__(
        self, machine: Machine, files: Mapping[str, Path], speed_factor: float, send: Callable[[Frame], None]
    ) -> None:
        self._machine = machine
        self._speed_factor = speed_factor
        self._time: float | None = None  # real time up to which the machine has run
        self._now = 0.0
        self.cycles = 0
        limits = joint_limits(machine.scenario.robot.urdf)
        self.nodes: dict[str, ForeignNode] = {}
        for number, info in enumerate(machine.axes, 1):
            if info.joint not in files:
                raise ScenarioError(f"joint {info.joint}: no dictionary for its drive")
            plate = _plate(info, limits[info.joint])
            self.nodes[info.joint] = ForeignNode(
                number, files[info.joint], plate, machine.cycle, send, can_move=not info.locked
            )
        self._axes = [(info, self.nodes[info.joint].axis) for info in machine.axes]
        self._effort_limits = {info.joint: inf for info in machine.axes}

    def boot(self) -> None:
        """Power on."""
        for (info, axis), position in zip(self._axes, self._machine.positions(), strict=True):
            axis.position = float(position) * info.gear_ratio / tau
        for node in self.nodes.values():
            node.boot()

    def receive(self, frame: Frame, now: float) -> None:
        """A frame of the bus at `now`, s of a monotonic clock."""
        self._now = now
        synced = [node for node in self.nodes.values() if frame.id == node.sync_id]
        for node in synced:
            node.sync(frame.data, now)
        self.switch()
        leader = next((node for node in synced if node.led_by_sync), None)
        if leader is not None:
            self.advance(leader.sync_cycles)
        for node in self.nodes.values():
            if node not in synced:
                node.receive(frame, now)
        self.switch()

    def run(self, now: float) -> None:
        """Advance machine and timers to `now`, at most by one chunk of cycles; call it again when `due`."""
        self._now = now
        pace, chunk = self._pace()
        if pace == 0.0 or self._time is None:
            self._time = now
        else:
            cycle = self._machine.cycle / pace
            self._time = max(self._time, now - _BACKLOG * chunk * cycle)
            if now - self._time > chunk * cycle - 1e-6:
                self._time += chunk * cycle
                self.advance(chunk)
        for node in self.nodes.values():
            node.run(now)
        self.switch()

    def due(self, now: float) -> float:
        """Seconds from `now` until `run` must be called; infinity if never."""
        pace, chunk = self._pace()
        times = [node.due(now) for node in self.nodes.values()]
        times += [node.synced_at + _SYNC_LOST for node in self.nodes.values() if node.led_by_sync and pace == 0.0]
        if pace > 0.0:
            times.append((now if self._time is None else self._time) + chunk * self._machine.cycle / pace)
        return max(min(times) - now, 0.0)

    def emergency_stop(self, *, on: bool) -> None:
        """Safe torque off for every axis, or its release."""
        for _, axis in self._axes:
            axis.stop_safely(on=on)
        self.switch()

    def status(self) -> dict[str, object]:
        """Status for the control port, in SI units on the joint side."""
        axes = {info.joint: self.axis_status(info, axis) for info, axis in self._axes}
        return {"axes": axes, "plant_time": self.cycles * self._machine.cycle}

    def axis_status(self, info: AxisInfo, axis: Axis) -> dict[str, object]:
        """Status of one axis; `effort` is the true torque of the motor, N m on the joint side."""
        node = self.nodes[info.joint]
        return {
            "position": axis.position * tau / info.gear_ratio,
            "velocity": axis.speed * tau / info.gear_ratio,
            "effort": axis.torque * info.gear_ratio,
            "state": axis.state.name.lower(),
            "energised": self._machine.energised(info.joint),
            "mode": int(axis.mode),
            "fault": axis.errors.code or None,
            "nmt": node.nmt.name.lower(),
            "maker": node.dictionary.maker.name,
        }

    def advance(self, cycles: int) -> None:
        """Run the machine for `cycles` of its cycles."""
        setpoints, injected = np.zeros((2, cycles, len(self._axes)))
        for k, (info, axis) in enumerate(self._axes):
            if axis.energised:
                self._limit_effort(info, axis)
                setpoints[:, k] = axis.setpoints(cycles) * tau / info.gear_ratio
                injected[:, k] = axis.injection() * info.gear_ratio
        samples = self._machine.advance(setpoints, injected if injected.any() else None)
        self.cycles += cycles
        for k, (info, axis) in enumerate(self._axes):
            if axis.energised:
                turns = info.gear_ratio / tau
                axis.observe(
                    Samples(
                        torque=samples.effort[:, k] / info.gear_ratio,
                        torque_limited=samples.torque_limited[:, k],
                        command=samples.velocity_setpoint[:, k] * turns,
                        speed=samples.velocity[:, k] * turns,
                        position=samples.position[:, k] * turns,
                        load=np.full(cycles, nan),
                        injected=samples.excitation_effort[:, k] / info.gear_ratio,
                    )
                )

    def switch(self) -> None:
        """Set torque and brakes of the machine according to the states of the axes; call after any change of a
        state.
        """
        for info, axis in self._axes:
            if axis.energised != self._machine.energised(info.joint):
                self._machine.energise(info.joint, axis.energised)

    def _pace(self) -> tuple[float, int]:
        """(simulated seconds per real second, cycles per chunk)."""
        axes = [axis for _, axis in self._axes if axis.energised]
        if not axes or any(n.led_by_sync and self._now - n.synced_at < _SYNC_LOST for n in self.nodes.values()):
            return 0.0, 1
        if not any(axis.moving for axis in axes):
            return 1.0, _HOLDING_CHUNK
        pace = self._speed_factor if all(a.mode is Mode.PROFILE_POSITION for a in axes if a.moving) else 1.0
        low, high = _CHUNK
        return pace, max(low, min(high, round(pace * 1e-3 / self._machine.cycle)))

    def _limit_effort(self, info: AxisInfo, axis: Axis) -> None:
        limit = min(axis.torque_limit * abs(info.gear_ratio), info.effort_limit)
        if limit != self._effort_limits[info.joint]:
            self._effort_limits[info.joint] = limit
            self._machine.set_effort_limit(info.joint, limit)


def _plate(info: AxisInfo, limits: Mapping[str, float]) -> Plate:
    turns = info.gear_ratio / tau
    ends = sorted((limits["lower"] * turns, limits["upper"] * turns))
    rated = info.rated_effort / abs(info.gear_ratio)
    return Plate(
        gear_ratio=info.gear_ratio,
        rated_torque=rated,
        most_torque=info.effort_limit / abs(info.gear_ratio),
        torque_constant=rated / _CURRENT,
        most_speed=limits["velocity"] * abs(turns),
        window=(ends[0], ends[1]),
    )
