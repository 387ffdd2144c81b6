"""The drive cabinet: a node an axis, one machine, one clock. Frames and times in, frames out; nothing else.

Whose clock? While an axis is in cyclic synchronous velocity, SYNC is: each advances the machine by one communication
cycle 1006h. Otherwise real time is, times `speed_factor` while something moves. Without any torque the
machine stands.
"""

from collections.abc import Callable
from math import inf, nan, tau
from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from simulator.canopen.node import SYNC_ID, Frame, Node
from simulator.drive.axis import Axis, Mode
from simulator.drive.dictionary import Key, Value
from simulator.drive.measuring import Samples
from simulator.drive.units import INCREMENTS, PER_MILLE, SPEED
from simulator.machine import AxisInfo, Machine

_MOVING_CHUNK = (4, 16)  # cycles run at a time while something moves
_HOLDING_CHUNK = 20  # cycles run at a time while nothing does
_BACKLOG = 4  # chunks that may be made up for when the computer was busy


class Cabinet:
    """Node ids 1, 2, ... in the order of the machine's joints."""

    def __init__(self, machine: Machine, eds: Path, speed_factor: float, send: Callable[[Frame], None]) -> None:
        self._machine = machine
        self._speed_factor = speed_factor
        self._time: float | None = None  # real time up to which the machine ran
        self.cycles = 0
        limits = _joint_limits(machine.scenario.robot.urdf)
        self.nodes: dict[str, Node] = {}
        for number, info in enumerate(machine.axes, 1):
            constants = _constants(info, limits[info.joint])
            self.nodes[info.joint] = Node(number, eds, machine.cycle, constants, send, can_move=not info.locked)
        self._axes = [(info, node.axis) for info, node in zip(machine.axes, self.nodes.values(), strict=True)]
        self._effort_limits = {info.joint: inf for info in machine.axes}

    def boot(self) -> None:
        """Power on."""
        for (info, axis), position in zip(self._axes, self._machine.positions(), strict=True):
            axis.position = float(position) * info.gear_ratio / tau
        for node in self.nodes.values():
            node.boot()

    def receive(self, frame: Frame, now: float) -> None:
        """A frame of the bus at `now`, s of a monotonic clock."""
        if frame.id == SYNC_ID:
            for node in self.nodes.values():
                node.sync(now)
            self._switch()
            leader = next((node for node in self.nodes.values() if node.axis.interpolating), None)
            if leader is not None:
                self._advance(round(leader.dictionary[0x1006, 0] * 1e-6 / self._machine.cycle))
        else:
            for node in self.nodes.values():
                node.receive(frame, now)
        self._switch()

    def run(self, now: float) -> None:
        """Let machine and timers go on to `now`, by one chunk of cycles at most: call it again when `due`."""
        pace, chunk = self._pace()
        if pace == 0.0 or self._time is None:
            self._time = now
        else:
            cycle = self._machine.cycle / pace
            self._time = max(self._time, now - _BACKLOG * chunk * cycle)
            cycles = min(int((now - self._time) / cycle + 1e-6), chunk)
            if cycles == chunk:
                self._time += cycles * cycle
                self._advance(cycles)
        for node in self.nodes.values():
            node.run(now)
        self._switch()

    def due(self, now: float) -> float:
        """Seconds from `now` until `run` is wanted; infinity if never."""
        pace, chunk = self._pace()
        next_chunk = inf
        if pace > 0.0:
            next_chunk = (now if self._time is None else self._time) + chunk * self._machine.cycle / pace
        return max(min(next_chunk, *(node.due(now) for node in self.nodes.values())) - now, 0.0)

    def emergency_stop(self, *, on: bool) -> None:
        """Safe torque off for every axis, or its release."""
        for _, axis in self._axes:
            axis.stop_safely(on=on)
        self._switch()

    def status(self) -> dict[str, object]:
        """What the control port tells: SI units of the joint side."""
        axes: dict[str, object] = {}
        for (info, axis), (joint, node) in zip(self._axes, self.nodes.items(), strict=True):
            fault = node.dictionary[0x603F, 0]
            axes[joint] = {
                "position": axis.position * tau / info.gear_ratio,
                "velocity": axis.speed * tau / info.gear_ratio,
                "state": axis.state.name.lower(),
                "nmt": node.nmt.name.lower(),
                "energised": self._machine.energised(joint),
                "mode": int(axis.mode),
                "fault": fault or None,
                "measuring": axis.measuring.run.name.lower(),
                "samples": axis.measuring.count,
            }
        counter = max(node.dictionary[0x2120, 1] for node in self.nodes.values())
        return {"axes": axes, "sync_counter": counter, "plant_time": self.cycles * self._machine.cycle}

    def _pace(self) -> tuple[float, int]:
        """(simulated seconds a real second, cycles a chunk)."""
        axes = [axis for _, axis in self._axes if axis.energised]
        if not axes or any(axis.interpolating for axis in axes):
            return 0.0, 1
        if not any(axis.moving or axis.settling for axis in axes):
            return 1.0, _HOLDING_CHUNK
        cyclic = any(axis.mode is Mode.CYCLIC_VELOCITY for axis in axes)
        pace = 1.0 if cyclic else self._speed_factor
        low, high = _MOVING_CHUNK
        return pace, max(low, min(high, round(pace * 1e-3 / self._machine.cycle)))

    def _advance(self, cycles: int) -> None:
        setpoints = np.zeros((cycles, len(self._axes)))
        for k, (info, axis) in enumerate(self._axes):
            if axis.energised:
                self._limit_effort(info, axis)
                setpoints[:, k] = axis.setpoints(cycles) * tau / info.gear_ratio
        samples = self._machine.advance(setpoints)
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
                        load=samples.load_position[:, k] / tau if info.load_encoder else np.full(cycles, nan),
                    )
                )

    def _limit_effort(self, info: AxisInfo, axis: Axis) -> None:
        limit = min(axis.torque_limit * info.rated_effort, info.effort_limit)
        if limit != self._effort_limits[info.joint]:
            self._effort_limits[info.joint] = limit
            self._machine.set_effort_limit(info.joint, limit)

    def _switch(self) -> None:
        """Torque and brakes of the machine as the axes' states say."""
        for info, axis in self._axes:
            if axis.energised != self._machine.energised(info.joint):
                self._machine.energise(info.joint, axis.energised)


def _constants(info: AxisInfo, limits: dict[str, float]) -> dict[Key, Value]:
    """Start values that depend on the motor; limits of the joint in rad, rad/s."""
    turns = info.gear_ratio / tau
    ends = sorted((limits["lower"] * turns * INCREMENTS, limits["upper"] * turns * INCREMENTS))
    speed = round(limits["velocity"] * abs(turns) * SPEED)
    return {
        (0x6072, 0): round(PER_MILLE * info.effort_limit / info.rated_effort),
        (0x6076, 0): round(PER_MILLE * info.rated_effort / abs(info.gear_ratio)),
        (0x607D, 1): round(ends[0]),
        (0x607D, 2): round(ends[1]),
        (0x607F, 0): speed,
        (0x6080, 0): speed,
        (0x6081, 0): speed // 10,
    }


def _joint_limits(urdf: str) -> dict[str, dict[str, float]]:
    """lower, upper and velocity of every joint that has limits."""
    limits: dict[str, dict[str, float]] = {}
    for joint in ElementTree.fromstring(urdf).iter("joint"):
        limit = joint.find("limit")
        if limit is not None:
            limits[joint.get("name", "")] = {
                name: float(limit.get(name, "0")) for name in ("lower", "upper", "velocity")
            }
    return limits
