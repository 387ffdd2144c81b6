"""The drive cabinet behind any fieldbus: one axis per node, one machine, one clock.

While an axis is in cyclic synchronous velocity, the fieldbus is the clock: it calls `advance`. Otherwise real time
is the clock, multiplied by `speed_factor` during motion. Without any torque the machine stands.
"""

from collections.abc import Mapping
from math import inf, nan, tau
from typing import Any, Generic, Protocol, TypeVar
from xml.etree import ElementTree

import numpy as np
import structlog

from simulator.drive.dictionary import ObjectDictionary, Value
from simulator.drive.foreign_axis import ForeignAxis
from simulator.drive.limits import INCREMENTS, PER_MILLE, speed_unit
from simulator.drive.makers import Key
from simulator.drive.measuring import DriveSamples
from simulator.drive.power_drive import Mode
from simulator.drive.virtual_axis import VirtualAxis
from simulator.machine import AxisInfo, LiveMachine

_log = structlog.get_logger(__name__)


class FieldbusNode(Protocol):
    """An axis with its dictionary on the fieldbus."""

    @property
    def number(self) -> int:
        """Node id or unit id."""
        ...

    def renumber(self, number: int) -> None:
        """Change the id, as by its address switches: the node boots with it. The device itself stays the same."""

    @property
    def axis(self) -> VirtualAxis | ForeignAxis: ...

    @property
    def dictionary(self) -> ObjectDictionary: ...

    def boot(self) -> None:
        """Power-on or reset: torque off, dictionary as in EDS and nameplate."""

    def run(self, now: float) -> None:
        """Process everything that is due at `now`, s."""

    def due(self, now: float) -> float:
        """Latest time at which `run` must be called, s; infinity if nothing is pending."""
        ...


class VirtualNodeLike(FieldbusNode, Protocol):
    """A node of the virtual drive."""

    @property
    def axis(self) -> VirtualAxis: ...


AnyNode = TypeVar("AnyNode", bound=FieldbusNode)
AnyVirtualNode = TypeVar("AnyVirtualNode", bound=VirtualNodeLike)


class DriveCabinet(Generic[AnyNode]):
    """`nodes` by joint, in the order of the machine's joints."""

    backlog = 4
    """Chunks that may be caught up after the computer was busy."""

    def __init__(self, machine: LiveMachine, nodes: Mapping[str, AnyNode], speed_factor: float) -> None:
        self._machine = machine
        self._speed_factor = speed_factor
        self._time: float | None = None  # real time up to which the machine has run
        self._now = 0.0
        self._slow = False  # it could not keep up
        self.cycles = 0
        self.nodes = dict(nodes)
        self._axes: list[tuple[AxisInfo, Any]] = [(info, self.nodes[info.joint].axis) for info in machine.axes]
        self._effort_limits = {info.joint: inf for info in machine.axes}

    def boot(self) -> None:
        for (info, axis), position in zip(self._axes, self._machine.positions(), strict=True):
            axis.position = float(position) * info.gear_ratio / tau
        for node in self.nodes.values():
            node.boot()

    def run(self, now: float) -> None:
        """Advance machine and timers to `now`, at most by one chunk of cycles; call it again when `due`."""
        self._now = now
        pace, chunk = self._pace()
        if pace == 0.0 or self._time is None:
            self._time = now
        else:
            cycle = self._machine.cycle / pace
            self._keep_up(now - self.backlog * chunk * cycle)
            cycles = min(int((now - self._time) / cycle + 1e-6), chunk)
            if cycles == chunk:
                self._time += cycles * cycle
                self.advance(cycles)
        for node in self.nodes.values():
            node.run(now)
        self.switch()

    def due(self, now: float) -> float:
        """Seconds from `now` until `run` must be called; infinity if never."""
        pace, chunk = self._pace()
        next_chunk = inf
        if pace > 0.0:
            next_chunk = (now if self._time is None else self._time) + chunk * self._machine.cycle / pace
        return max(min(next_chunk, *(node.due(now) for node in self.nodes.values())) - now, 0.0)

    def emergency_stop(self, *, on: bool) -> None:
        """Safe torque off for every axis, or its release."""
        for _, axis in self._axes:
            axis.stop_safely(on=on)
        self.switch()

    def status(self) -> dict[str, object]:
        """Status for the control port, in SI units on the joint side."""
        axes = {info.joint: self.axis_status(info, axis) for info, axis in self._axes}
        return {"axes": axes, "plant_time": self.cycles * self._machine.cycle}

    def axis_status(self, info: AxisInfo, axis: Any) -> dict[str, object]:
        return {
            "position": axis.position * tau / info.gear_ratio,
            "velocity": axis.speed * tau / info.gear_ratio,
            "state": axis.state.name.lower(),
            "energised": self._machine.energised(info.joint),
            "mode": int(axis.mode),
            "fault": axis.errors.code or None,
        }

    def advance(self, cycles: int) -> None:
        """Run the machine for `cycles` of its cycles."""
        setpoints = np.zeros((cycles, len(self._axes)))
        injected = np.zeros_like(setpoints)
        for k, (info, axis) in enumerate(self._axes):
            if axis.energised:
                self._prepare(info, axis)
                torque = axis.injection(cycles)
                if torque is not None:
                    injected[:, k] = torque * info.gear_ratio
                setpoints[:, k] = axis.setpoints(cycles) * tau / info.gear_ratio
        samples = self._machine.advance(setpoints, injected if injected.any() else None)
        self.cycles += cycles
        for k, (info, axis) in enumerate(self._axes):
            if axis.energised:
                turns = info.gear_ratio / tau
                axis.observe(
                    DriveSamples(
                        torque=samples.effort[:, k] / info.gear_ratio,
                        torque_limited=samples.torque_limited[:, k],
                        command=samples.velocity_setpoint[:, k] * turns,
                        speed=samples.velocity[:, k] * turns,
                        position=samples.position[:, k] * turns,
                        load=samples.load_position[:, k] / tau if info.load_encoder else np.full(cycles, nan),
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
        """(simulated seconds per real second, 0: not by real time; cycles per chunk)."""
        raise NotImplementedError

    def _keep_up(self, latest: float) -> None:
        """Drop what lies before `latest`, s: a computer that is too slow slows the clock of the machine, no motion."""
        if self._time is not None and self._time < latest:
            if not self._slow:
                _log.warning("too slow: the machine's clock runs slower than asked", speed_factor=self._speed_factor)
            self._slow, self._time = True, latest

    def _torque_limit(self, info: AxisInfo, axis: Any) -> float:
        """Maximum torque of the drive, N m on the joint side."""
        raise NotImplementedError

    def _paced(self, *, moves: bool, at_speed: bool) -> tuple[float, int]:
        """While an axis moves, and may move faster than in real time."""
        if not moves:
            return 1.0, 20
        pace = self._speed_factor if at_speed else 1.0
        return pace, max(4, min(16, round(pace * 1e-3 / self._machine.cycle)))

    def _prepare(self, info: AxisInfo, axis: Any) -> None:
        """Limits and parameters of the drive that may have changed."""
        limit = min(self._torque_limit(info, axis), info.effort_limit)
        if limit != self._effort_limits[info.joint]:
            self._effort_limits[info.joint] = limit
            self._machine.set_effort_limit(info.joint, limit)


class VirtualDriveCabinet(DriveCabinet[AnyVirtualNode]):
    """A cabinet of virtual drives. Raises ScenarioError for an EDS with unsupported units."""

    def __init__(self, machine: LiveMachine, nodes: Mapping[str, AnyVirtualNode], speed_factor: float) -> None:
        # Used even if the EDS has no such object.
        inside = frozenset({(0x6072, 0), (0x6076, 0), (0x6080, 0), *((0x2140, sub) for sub in range(1, 5))})
        super().__init__(machine, nodes, speed_factor)
        limits = joint_limits(machine.scenario.robot.urdf)
        self._controls: dict[str, tuple[float, float]] = {}
        for info in machine.axes:
            d = self.nodes[info.joint].dictionary
            plate = _nameplate(info, limits[info.joint], speed_unit(d))
            d.nameplate |= {key: value for key, value in plate.items() if key in inside or key in d}
            self._controls[info.joint] = info.gain / info.gear_ratio**2, info.reset_time

    def axis_status(self, info: AxisInfo, axis: VirtualAxis) -> dict[str, object]:
        return super().axis_status(info, axis) | {
            "measuring": axis.measuring.run.name.lower(),
            "samples": axis.measuring.count,
            "softened": axis.speed_control.softened,
        }

    def _pace(self) -> tuple[float, int]:
        axes = [axis for _, axis in self._axes if axis.energised]
        if not axes or any(axis.interpolating for axis in axes):
            return 0.0, 1
        at_speed = not any(axis.mode is Mode.CYCLIC_VELOCITY for axis in axes)
        return self._paced(moves=any(axis.moving or axis.settling for axis in axes), at_speed=at_speed)

    def _torque_limit(self, info: AxisInfo, axis: VirtualAxis) -> float:
        return axis.torque_limit * info.rated_effort

    def _prepare(self, info: AxisInfo, axis: VirtualAxis) -> None:
        super()._prepare(info, axis)
        control = axis.speed_control.active
        if control != self._controls[info.joint]:
            self._controls[info.joint] = control
            self._machine.tune(info.joint, control[0] * info.gear_ratio**2, control[1])


def _nameplate(info: AxisInfo, limits: Mapping[str, float], speed: float) -> dict[Key, Value]:
    """Initial values that depend on the motor; limits of the joint in rad, rad/s; `speed`: units per 1 rev/s."""
    turns = info.gear_ratio / tau
    ends = sorted((limits["lower"] * turns * INCREMENTS, limits["upper"] * turns * INCREMENTS))
    fastest = round(limits["velocity"] * abs(turns) * speed)
    control = (info.gain / info.gear_ratio**2, info.reset_time)
    return {
        **{(0x2140, sub): value for sub, value in enumerate(control * 2, 1)},
        (0x6072, 0): round(PER_MILLE * info.effort_limit / info.rated_effort),
        (0x6076, 0): round(PER_MILLE * info.rated_effort / abs(info.gear_ratio)),
        (0x607D, 1): round(ends[0]),
        (0x607D, 2): round(ends[1]),
        (0x607F, 0): fastest,
        (0x6080, 0): fastest,
        (0x6081, 0): fastest // 10,
    }


def joint_limits(urdf: str) -> dict[str, dict[str, float]]:
    """lower, upper and velocity of every joint that has limits."""
    limits: dict[str, dict[str, float]] = {}
    for joint in ElementTree.fromstring(urdf).iter("joint"):
        limit = joint.find("limit")
        if limit is not None:
            limits[joint.get("name", "")] = {
                name: float(limit.get(name, "0")) for name in ("lower", "upper", "velocity")
            }
    return limits
