"""The drive cabinet behind any fieldbus: one axis per node, one machine, one clock.

While an axis is in cyclic synchronous velocity, the fieldbus is the clock: it calls `advance`. Otherwise real time
is the clock, multiplied by `speed_factor` during motion. Without any torque the machine stands.
"""

from collections.abc import Mapping
from math import inf, nan, tau
from typing import Generic, Protocol, TypeVar
from xml.etree import ElementTree

import numpy as np

from simulator.drive.axis import Axis, Mode
from simulator.drive.dictionary import Dictionary, Key, Value
from simulator.drive.measuring import Samples
from simulator.drive.units import INCREMENTS, PER_MILLE, speed_unit
from simulator.machine import AxisInfo, Machine

_MOVING_CHUNK = (4, 16)  # cycles per call during motion
_HOLDING_CHUNK = 20  # cycles per call at standstill
_BACKLOG = 4  # chunks that may be caught up after the computer was busy
_CONTROL = ((0x2140, 1), (0x2140, 2), (0x2140, 3), (0x2140, 4))
_INSIDE = ((0x6072, 0), (0x6076, 0), (0x6080, 0), *_CONTROL)  # used even if the EDS has no such object


class Node(Protocol):
    """An axis with its dictionary on the fieldbus."""

    @property
    def number(self) -> int:
        """Node id or unit id."""
        ...

    def renumber(self, number: int) -> None:
        """Change the id, as by its address switches: the node boots with it. The device itself stays the same."""

    @property
    def axis(self) -> Axis: ...

    @property
    def dictionary(self) -> Dictionary: ...

    def boot(self) -> None:
        """Power-on or reset: torque off, dictionary as in EDS and nameplate."""

    def run(self, now: float) -> None:
        """Process everything that is due at `now`, s."""

    def due(self, now: float) -> float:
        """Latest time at which `run` must be called, s; infinity if nothing is pending."""
        ...


AnyNode = TypeVar("AnyNode", bound=Node)


class Cabinet(Generic[AnyNode]):
    """`nodes` by joint, in the order of the machine's joints. Raises ScenarioError for an EDS with unsupported
    units.
    """

    def __init__(self, machine: Machine, nodes: Mapping[str, AnyNode], speed_factor: float) -> None:
        self._machine = machine
        self._speed_factor = speed_factor
        self._time: float | None = None  # real time up to which the machine has run
        self.cycles = 0
        self.nodes = dict(nodes)
        limits = joint_limits(machine.scenario.robot.urdf)
        for info in machine.axes:
            dictionary = self.nodes[info.joint].dictionary
            plate = _nameplate(info, limits[info.joint], speed_unit(dictionary))
            dictionary.nameplate |= {k: value for k, value in plate.items() if k in _INSIDE or k in dictionary}
        self._axes = [(info, self.nodes[info.joint].axis) for info in machine.axes]
        self._effort_limits = {info.joint: inf for info in machine.axes}
        self._controls = {
            joint: (node.dictionary.nameplate[0x2140, 1], node.dictionary.nameplate[0x2140, 2])
            for joint, node in self.nodes.items()
        }

    def boot(self) -> None:
        """Power on."""
        for (info, axis), position in zip(self._axes, self._machine.positions(), strict=True):
            axis.position = float(position) * info.gear_ratio / tau
        for node in self.nodes.values():
            node.boot()

    def run(self, now: float) -> None:
        """Advance machine and timers to `now`, at most by one chunk of cycles; call it again when `due`."""
        pace, chunk = self._pace()
        if pace == 0.0 or self._time is None:
            self._time = now
        else:
            cycle = self._machine.cycle / pace
            self._time = max(self._time, now - _BACKLOG * chunk * cycle)
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

    def axis_status(self, info: AxisInfo, axis: Axis) -> dict[str, object]:
        """Status of one axis."""
        return {
            "position": axis.position * tau / info.gear_ratio,
            "velocity": axis.speed * tau / info.gear_ratio,
            "state": axis.state.name.lower(),
            "energised": self._machine.energised(info.joint),
            "mode": int(axis.mode),
            "fault": self.nodes[info.joint].dictionary[0x603F, 0] or None,
            "measuring": axis.measuring.run.name.lower(),
            "samples": axis.measuring.count,
            "softened": axis.speed_control.softened,
        }

    def advance(self, cycles: int) -> None:
        """Run the machine for `cycles` of its cycles."""
        setpoints = np.zeros((cycles, len(self._axes)))
        injected = np.zeros_like(setpoints) if any(axis.measuring.injecting for _, axis in self._axes) else None
        for k, (info, axis) in enumerate(self._axes):
            if axis.energised:
                self._limit_effort(info, axis)
                self._tune(info, axis)
                if injected is not None:
                    injected[:, k] = axis.measuring.injection(cycles) * info.gear_ratio
                setpoints[:, k] = axis.setpoints(cycles) * tau / info.gear_ratio
        samples = self._machine.advance(setpoints, injected)
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
        if not axes or any(axis.interpolating for axis in axes):
            return 0.0, 1
        if not any(axis.moving or axis.settling for axis in axes):
            return 1.0, _HOLDING_CHUNK
        cyclic = any(axis.mode is Mode.CYCLIC_VELOCITY for axis in axes)
        pace = 1.0 if cyclic else self._speed_factor
        low, high = _MOVING_CHUNK
        return pace, max(low, min(high, round(pace * 1e-3 / self._machine.cycle)))

    def _limit_effort(self, info: AxisInfo, axis: Axis) -> None:
        limit = min(axis.torque_limit * info.rated_effort, info.effort_limit)
        if limit != self._effort_limits[info.joint]:
            self._effort_limits[info.joint] = limit
            self._machine.set_effort_limit(info.joint, limit)

    def _tune(self, info: AxisInfo, axis: Axis) -> None:
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
        **dict(zip(_CONTROL, control * 2, strict=True)),
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
