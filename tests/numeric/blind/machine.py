"""A machine that hides something: built as its data sheet says, changed by effects, then only measured."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from service.diagnosis.sensitivity.design import DesignedSweep
from service.identification.estimates.torque_gain import KnownMass
from service.recording import Recording, Sweep
from service.robot import Robot
from simulator import DrivenAxis, DriveTrain, Gravity, LinkDeviation, Scenario, SpeedControl, SweepRun, run_sweeps
from simulator.rigid_body import RigidBody
from simulator.scenario import AddedBody, NominalRobot

Array = NDArray[np.float64]

RIGID_BAND = 30.0  # Hz of the speed control
ELASTIC_BAND = 8.0
FLANGE = "link_6"  # carried by the last joint
STIFF = 350.0  # Hz, locked rotor of a gear that has play or error but no elasticity to speak of


@dataclass
class Draft:
    """What is still being built. `size` is the largest torque, N m, of the effect to hide."""

    random: np.random.Generator
    robot: Robot
    nominal: NominalRobot
    joint: str
    designs: tuple[DesignedSweep, ...]
    size: float
    train: dict[str, Any]
    measurement: dict[str, float]
    links: dict[str, dict[str, Any]]
    later: dict[str, Any] = field(default_factory=dict)  # of the train, from the middle of the campaign on
    band: float = RIGID_BAND

    @property
    def index(self) -> int:
        return self.robot.index(self.joint)

    @property
    def poses(self) -> Array:
        """Different poses of the designed sweeps (m, n)."""
        return np.array(list(dict.fromkeys(design.spec.pose for design in self.designs)))

    @property
    def slow(self) -> float:
        """Offset of the slowest turning sweeps, rad/s."""
        return min(abs(d.spec.offset_velocity) for d in self.designs if d.spec.offset_velocity)

    @property
    def ratio(self) -> float:
        return self.nominal.axes[self.index].gear_ratio

    @property
    def motor_inertia(self) -> float:
        """At the joint, kg m^2."""
        return self.train["motor_inertia"] * self.ratio**2

    def load_inertia(self) -> Array:
        """True inertia behind the gear in each pose (m,), kg m^2."""
        body = RigidBody(self.scenario())
        return np.array([body.inertia(pose)[self.index] for pose in self.poses])

    def gravity(self) -> Array:
        """True gravity torque in each pose (m,), N m."""
        body = RigidBody(self.scenario())
        curves: list[Gravity] = [body.gravity(self.index, pose) for pose in self.poses]
        return np.array([curve.at(pose[self.index]) for curve, pose in zip(curves, self.poses, strict=True)])

    def friction(self, **parts: Any) -> None:
        """Add to the motor's friction."""
        self.train["motor_friction"] = self.train["motor_friction"] | parts

    def spring(self, **parts: Any) -> None:
        """Give the gear its spring, one too stiff to see unless said otherwise."""
        load = float(self.load_inertia().min())
        stiffness = parts.pop("stiffness", load * (2 * np.pi * STIFF) ** 2)
        damping = parts.pop("damping", 0.3 * np.sqrt(stiffness * load))
        self.train["spring"] = {"stiffness": stiffness, "damping": damping} | parts

    def scenario(self, *, later: bool = False) -> Scenario:
        """The machine; from the middle of the campaign on where `later`."""
        train = DriveTrain.model_validate(self.train | (self.later if later else {}))
        rated = self.nominal.axes[self.index].rated_effort
        inertia = self.motor_inertia + 0.3 * rated / 9.81  # about that of the load
        control = SpeedControl(gain=2 * np.pi * self.band * inertia, reset_time=0.08, effort_limit=3 * rated)
        return Scenario.model_validate(
            {
                "name": self.robot.name,
                "robot": self.nominal,
                "links": self.links,
                "axes": {self.joint: DrivenAxis(train=train, control=control, load_encoder=False)},
                "measurement": self.measurement,
            }
        )


class BlindMachine:
    """Can be measured, and nothing else."""

    def __init__(self, draft: Draft, seed: int) -> None:
        self._before, self._after = draft.scenario(), draft.scenario(later=True)
        starts = [design.spec.started_at for design in draft.designs]
        self._middle = (starts[0] + starts[-1]) / 2 if draft.later else np.inf
        self._seed = seed
        self._past: list[DesignedSweep] = []

    def measure(self, designs: Sequence[DesignedSweep], bar: AddedBody | None = None) -> tuple[Sweep, ...]:
        """The recordings of designed sweeps, in their order; `bar`: with that on the flange.

        A gear that warms is as warm as all sweeps before have left it.
        """
        past = self._past if self._before.axes[designs[0].spec.axis].train.warming else []
        self._past = [*self._past, *designs]
        measured = self._measure([*past, *designs], bar)
        return tuple(measured[k] for k in range(len(past), len(measured)))

    def _measure(self, designs: Sequence[DesignedSweep], bar: AddedBody | None) -> dict[int, Sweep]:
        sweeps: dict[int, Sweep] = {}
        for part, machine in enumerate((self._before, self._after)):
            scenario = machine if bar is None else _carrying(machine, bar)
            numbers = [k for k, d in enumerate(designs) if (d.spec.started_at > self._middle) == bool(part)]
            runs = [_run(designs[k]) for k in numbers]
            self._seed += 1
            for k, columns in zip(numbers, run_sweeps(scenario, runs, self._seed), strict=True):
                sweeps[k] = Sweep(designs[k].spec, Recording(**columns))
        return sweeps


def known_mass(bar: AddedBody) -> KnownMass:
    """A bar along x as the service is told of it."""
    length = abs(bar.end[0] - bar.start[0])
    along, across = bar.mass * bar.radius**2 / 2, bar.mass * (3 * bar.radius**2 + length**2) / 12
    centre = ((bar.start[0] + bar.end[0]) / 2, bar.start[1], bar.start[2])
    return KnownMass(bar.mass, centre, (along, 0.0, across, 0.0, 0.0, across))


def _carrying(scenario: Scenario, bar: AddedBody) -> Scenario:
    flange = scenario.links.get(FLANGE, LinkDeviation())
    loaded = flange.model_copy(update={"added": (*flange.added, bar)})
    return scenario.model_copy(update={"links": scenario.links | {FLANGE: loaded}})


def _run(design: DesignedSweep) -> SweepRun:
    spec = design.spec
    return SweepRun(
        axis=spec.axis,
        pose=spec.pose,
        offset_velocity=spec.offset_velocity,
        sines=tuple((sine.frequency, sine.amplitude, sine.phase) for sine in spec.sines),
        period=spec.period or 1.0,
        periods=spec.periods or 1,
        ramp=design.ramp,
        settle=design.settle,
        sample_rate=spec.sample_rate,
        started_at=spec.started_at,
    )
