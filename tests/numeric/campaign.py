"""Simulated campaigns for the numeric tests: scenario -> sweeps -> spectra, with the truth kept apart."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import yaml

from service.identification.design.excitation import Excitation, design_sweep
from service.identification.model import inertia_rows, lock
from service.identification.spectra.frequency_response import Spectrum, spectrum
from service.model import Recording, Robot, RobotDescription, Sweep, SweepSpec, build_robot
from simulator import Scenario, SweepRun, load_scenario, run_sweeps, true_inertia

CONFIG = Path(__file__).parents[2] / "config"
AXES = ("joint_1", "joint_2", "joint_3")
# data-sheet stiffness of the gears, N m/rad: only the design of the sweeps uses it
STIFFNESS = {"joint_1": 7e5, "joint_2": 1.8e6, "joint_3": 4e5}


@dataclass(frozen=True)
class SimulatedCampaign:
    robot: Robot
    scenario: Scenario
    sweeps: tuple[Sweep, ...]

    @property
    def spectra(self) -> list[Spectrum]:
        return [spectrum(self.robot, sweep) for sweep in self.sweeps]

    def truth(self, joint: str) -> np.ndarray:
        """True inertia in the poses of an axis' sweeps."""
        poses = [sweep.spec.pose for sweep in self.sweeps if sweep.spec.axis == joint]
        return true_inertia(self.scenario, joint, np.array(poses))


def max100() -> Robot:
    """The representative robot as its users get it."""
    description = RobotDescription.model_validate(yaml.safe_load((CONFIG / "robots/max100-class.yaml").read_text()))
    return build_robot(description, (CONFIG / "robots" / description.urdf).read_text())


def scenario_named(name: str) -> Scenario:
    """A scenario of the configuration."""
    return load_scenario(CONFIG / f"scenarios/{name}.yaml")


def measure(
    name: str, seed: int, poses: int = 24, sample_rate: float = 1000.0, direct_encoder: bool = False
) -> SimulatedCampaign:
    """`poses` random poses of axes 2 and 3, each measured on axes 1 to 3 of scenario `name`."""
    rng = np.random.default_rng(seed)
    grid = np.zeros((poses, 6))
    grid[:, 1], grid[:, 2] = rng.uniform(-1.2, 1.2, poses), rng.uniform(-2.0, 1.2, poses)
    return measure_at(scenario_named(name), seed, grid, sample_rate, direct_encoder)


def measure_at(
    scenario: Scenario,
    seed: int,
    poses: np.ndarray,
    sample_rate: float = 1000.0,
    direct_encoder: bool = False,
    axes: Sequence[str] = AXES,
) -> SimulatedCampaign:
    """Sweeps of `axes` in `poses` (m, 6). Recordings have the load's motion only with `direct_encoder`."""
    specs, runs = planned_at(scenario, poses, sample_rate, axes)
    recordings = [Recording(**columns) for columns in run_sweeps(scenario, runs, seed)]
    if not direct_encoder:
        recordings = [replace(one, load_position=None, load_velocity=None) for one in recordings]
    return SimulatedCampaign(max100(), scenario, tuple(map(Sweep, specs, recordings)))


def planned_at(
    scenario: Scenario, poses: np.ndarray, sample_rate: float = 1000.0, axes: Sequence[str] = AXES
) -> tuple[list[SweepSpec], list[SweepRun]]:
    """The sweeps of `axes` in `poses` (m, 6), to be recorded and to be run."""
    robot = max100()
    locked = lock(robot.chain, {3: 0.0, 4: 0.0, 5: 0.0})
    specs: list[SweepSpec] = []
    runs: list[SweepRun] = []
    for joint in axes:
        loads = inertia_rows(locked, robot.index(joint), poses[:, :3]) @ locked.inertial.ravel()
        for pose, load in zip(poses, loads, strict=True):
            stiff = scenario.name.endswith("rigid")
            resonance = None if stiff else float(np.sqrt(STIFFNESS[joint] / load) / (2 * np.pi))
            sweep = design_sweep(robot, joint, pose, load_inertia=float(load), locked_rotor_frequency=resonance)
            specs.append(spec_of(sweep, len(specs) + 1, joint, pose, sample_rate))
            runs.append(run_of(specs[-1], sweep.ramp, sweep.settle))
    return specs, runs


def spec_of(
    sweep: Excitation, number: int, axis: str, pose: Iterable[float], sample_rate: float = 1000.0, **others: Any
) -> SweepSpec:
    """What a recording is said to be of a designed sweep."""
    shape = {"offset_velocity": sweep.offset_velocity, "sines": sweep.sines, "measure_from": sweep.measure_from}
    shape |= {"period": sweep.period, "periods": sweep.periods, "sample_rate": sample_rate}
    place = {"id": f"{number:04}", "axis": axis, "pose": tuple(map(float, pose))}
    return SweepSpec.model_validate(place | shape | others)


def run_of(spec: SweepSpec, ramp: float, settle: float, **others: float) -> SweepRun:
    """What a simulated machine needs of a sweep."""
    sines = tuple((sine.frequency, sine.amplitude, sine.phase) for sine in spec.sines)
    shape = (spec.axis, spec.pose, spec.offset_velocity, sines, spec.period or 0.0, spec.periods or 0, ramp, settle)
    return SweepRun(*shape, **{"sample_rate": spec.sample_rate} | others)


class Planned(Protocol):
    """A sweep that a plan or a design has."""

    @property
    def spec(self) -> SweepSpec: ...
    @property
    def ramp(self) -> float: ...
    @property
    def settle(self) -> float: ...


def run_plan(scenario: Scenario, planned: Sequence[Planned], seed: int, direct_encoder: bool = False) -> list[Sweep]:
    """The sweeps of a plan, run by a simulated machine."""
    columns = run_sweeps(scenario, [run_of(sweep.spec, sweep.ramp, sweep.settle) for sweep in planned], seed)
    recordings = [Recording(**one) for one in columns]
    if not direct_encoder:
        recordings = [replace(one, load_position=None, load_velocity=None) for one in recordings]
    return [Sweep(sweep.spec, recording) for sweep, recording in zip(planned, recordings, strict=True)]
