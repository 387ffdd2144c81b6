"""The live virtual machine: axes with brakes that receive velocity set-points and return samples, one row per cycle.

While more than one brake is open, the axes are coupled (`coupled`).
"""

from dataclasses import dataclass

import numpy as np

from simulator.plant import CoupledTrains, Plant, Samples, measure
from simulator.scenario import CYCLE, STEP, Scenario, ScenarioError
from simulator.waveform import Array


@dataclass(frozen=True, slots=True)
class AxisInfo:
    """Data for the dictionary of an axis' drive, on the joint side."""

    joint: str
    gear_ratio: float
    rated_effort: float  # N m
    effort_limit: float  # N m
    gain: float  # N m s/rad, of the speed control; 0 where locked
    reset_time: float  # s
    load_encoder: bool
    locked: bool  # its brake cannot be opened


class LiveMachine:
    """Every joint of the robot, base to tip; initially all brakes are closed and all positions zero. Not
    thread-safe.
    """

    cycle = CYCLE

    def __init__(self, scenario: Scenario, seed: int) -> None:
        self.scenario = scenario
        self.joints = scenario.joints
        self.axes = tuple(_info(scenario, joint) for joint in self.joints)
        self._driven = tuple(k for k, axis in enumerate(self.axes) if not axis.locked)
        self._row = {joint: row for row, joint in enumerate(scenario.joints[k] for k in self._driven)}
        self._pose = np.zeros(len(self.joints))
        self._loaded = self._pose.copy()  # the pose for which the plant has inertia and gravity
        self._trains = CoupledTrains(scenario, STEP)
        controls = [scenario.axes[joint].control for joint in self._row]
        self._plant = Plant(self._trains.axes, controls, scenario.measurement)
        self._plant.trains = self._trains
        self._rated = np.array([self.axes[k].rated_effort for k in self._driven])
        self._random = [np.random.default_rng(s) for s in np.random.SeedSequence(seed).spawn(len(self._driven))]

    def energise(self, joint: str, on: bool) -> None:
        """Open the brake of a joint in closed loop at standstill, or close it. Raises ScenarioError if it is locked."""
        self.scenario.driven(joint)
        row = self._row[joint]
        if not on:
            self._plant.brake(row)
        elif not self._plant.trains.free[row]:
            self._load_pose(self.positions())
            self._plant.release(row)

    def energised(self, joint: str) -> bool:
        return joint in self._row and bool(self._plant.trains.free[self._row[joint]])

    def set_position(self, joint: str, position: float) -> None:
        """Set the start position of a braked joint, rad. Raises ScenarioError if it is energised."""
        self.scenario.nominal(joint)
        if self.energised(joint):
            raise ScenarioError(f"joint {joint}: cannot be put elsewhere while it is energised")
        self._pose[self.joints.index(joint)] = position
        if joint in self._row:
            self._plant.trains.position[:, self._row[joint]] = position

    def set_effort_limit(self, joint: str, limit: float) -> None:
        """Torque limit of a joint, N m on the joint side."""
        self.scenario.driven(joint)
        if not limit >= 0:
            raise ScenarioError(f"joint {joint}: torque limit {limit} N m is negative")
        self._plant.loop.limit[self._row[joint]] = limit

    def positions(self) -> Array:
        """Motor positions on the joint side, (n,) rad."""
        self._pose[list(self._driven)] = self._plant.trains.position[0]
        return self._pose.copy()

    def tune(self, joint: str, gain: float, reset_time: float) -> None:
        """Set the speed control of a joint, N m s/rad on the joint side and s, both above 0. ScenarioError if it is
        locked.
        """
        self.scenario.driven(joint)
        self._plant.tune(self._row[joint], gain, reset_time)

    def advance(self, setpoints: Array, injected: Array | None = None) -> Samples:
        """Run m cycles with velocity set-points (m, n) rad/s; returns measured samples (m, n). Braked joints do not
        move.

        `injected` (m, n): torque added to that of the speed controllers, N m on the joint side; default none.
        """
        if setpoints.ndim != 2 or setpoints.shape[1] != len(self.joints):
            raise ValueError(f"set-points {setpoints.shape} must be (cycles, {len(self.joints)})")
        driven = list(self._driven)
        pose = self.positions()
        free = self._plant.trains.free
        shift = np.abs(pose - self._loaded)
        if np.count_nonzero(free) == 1:  # the motion of an axis does not change its own inertia
            shift[self._driven[int(free.argmax())]] = 0.0
        if shift.max() > 1e-3:  # rad
            self._load_pose(pose)
        torque = None if injected is None else injected[:, driven] * free
        clean = self._plant.advance(setpoints[:, driven] * free, torque)
        measured = measure(clean, self.scenario.measurement, self._rated, self._random)

        def whole(part: Array, locked: Array) -> Array:
            """Columns of all joints: `part` of the driven ones, `locked` (n,) of the others."""
            columns = np.empty((len(setpoints), len(locked)))
            columns[:] = locked
            columns[:, driven] = part
            return columns

        nothing = np.zeros(len(self.joints))
        return Samples(
            effort=whole(measured.effort, nothing),
            velocity=whole(measured.velocity, nothing),
            position=whole(measured.position, self._pose),
            load_position=whole(measured.load_position, self._pose),
            load_velocity=whole(measured.load_velocity, nothing),
            velocity_setpoint=whole(measured.velocity_setpoint, nothing),
            excitation_effort=whole(measured.excitation_effort, nothing),
            torque_limited=whole(measured.torque_limited.astype(float), nothing) > 0,
        )

    def _load_pose(self, pose: Array) -> None:
        self._trains.take_pose(pose)
        self._loaded = pose


def _info(scenario: Scenario, joint: str) -> AxisInfo:
    nominal, driven = scenario.nominal(joint), scenario.axes.get(joint)
    return AxisInfo(
        joint=joint,
        gear_ratio=nominal.gear_ratio,
        rated_effort=nominal.rated_effort,
        effort_limit=driven.control.effort_limit if driven else nominal.rated_effort,
        gain=driven.control.gain if driven else 0.0,
        reset_time=driven.control.reset_time if driven else 0.0,
        load_encoder=driven.load_encoder if driven else False,
        locked=driven is None,
    )
