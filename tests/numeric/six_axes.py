"""Six axes of the simulated machine: sweeps of all axes in many poses, exciting trajectories of all axes at once."""

from collections.abc import Sequence

import numpy as np

from service.identification.design.diagnosis_sweeps import DesignedSweep
from service.identification.design.excitation import design_sweep
from service.identification.design.exciting_trajectory import (
    Trajectory,
    TrajectoryLimits,
    TrajectoryShape,
    design_trajectory,
)
from service.identification.estimates.combination import JointEstimate
from service.identification.model import dynamic_base, inertia_rows, joint_ranges
from service.identification.motion.trajectory_record import TrajectoryRecord, axis_track, trajectory
from service.identification.spectra.frequency_response import Spectrum, spectrum, window
from service.model import Recording, Robot, Sweep, read_chain
from service.model.collision import CollisionChecker
from service.model.configuration import read_cell
from simulator import Scenario, run_trajectories
from simulator.rigid_body import real_urdf
from tests.numeric.campaign import CONFIG, run_of, run_plan, spec_of

# data-sheet stiffness of the gears, N m/rad: only the design of the sweeps uses it
STIFFNESS = (7e5, 1.8e6, 4e5, 5e4, 4.5e4, 1.2e4)
VELOCITY, ACCELERATION = 0.8, 1.5  # rad/s, rad/s^2, of a trajectory


def checker(robot: Robot) -> CollisionChecker:
    return CollisionChecker(robot, read_cell(CONFIG / "cells" / "workshop.yaml"))


def limits(robot: Robot, margin: float = 0.1) -> TrajectoryLimits:
    lower, upper = joint_ranges(robot.chain)
    effort = 0.9 * np.array([joint.effort for joint in robot.chain.joints])
    joints = len(robot.axes)
    return TrajectoryLimits(
        lower + margin, upper - margin, np.full(joints, VELOCITY), np.full(joints, ACCELERATION), effort
    )


def design(robot: Robot, shape: TrajectoryShape, seed: int, restarts: int = 30, steps: int = 150) -> Trajectory:
    collisions = checker(robot)
    columns = dynamic_base(robot).columns
    return design_trajectory(
        robot, columns, limits(robot), shape, collisions.path_free, seed=seed, restarts=restarts, steps=steps
    )


def measure_trajectories(
    robot: Robot, scenario: Scenario, trajectories: Sequence[Trajectory], seed: int, sample_rate: float = 250.0
) -> list[list[Sweep]]:
    """The sweeps of every trajectory as the machine records them, one an axis."""
    specs, runs = [], []
    for number, run in enumerate(trajectories):
        own = [
            spec_of(
                excitation,
                axis,
                joint,
                run.start,
                sample_rate,
                id=f"T{number:02}-{axis}",
                offset_velocity=0.0,
                excitation="trajectory",
                started_at=100.0 * number,
                block=f"trajectory {number}",
            )
            for axis, (joint, excitation) in enumerate(zip(robot.joints, run.excitations, strict=True))
        ]
        specs.append(own)
        runs.append([run_of(spec, one.ramp, one.settle) for spec, one in zip(own, run.excitations, strict=True)])
    recordings = run_trajectories(scenario, runs, seed)
    return [
        [Sweep(spec, Recording(**columns)) for spec, columns in zip(own, recorded, strict=True)]
        for own, recorded in zip(specs, recordings, strict=True)
    ]


def measure_sweeps(
    robot: Robot, scenario: Scenario, poses: np.ndarray, seed: int, sample_rate: float = 250.0
) -> tuple[list[Sweep], list[Spectrum]]:
    """One sweep of every axis in each of the poses (m, n), and their spectra."""
    designed: list[DesignedSweep] = []
    for number, joint in enumerate(robot.joints):
        loads = inertia_rows(robot.chain, number, poses) @ robot.chain.inertial.ravel()
        for pose, load in zip(poses, loads, strict=True):
            resonance = float(np.sqrt(STIFFNESS[number] / load) / (2 * np.pi))
            sweep = design_sweep(robot, joint, pose, load_inertia=float(load), locked_rotor_frequency=resonance)
            spec = spec_of(sweep, len(designed) + 1, joint, pose, sample_rate)
            designed.append(DesignedSweep(spec, sweep.ramp, sweep.settle))
    sweeps = run_plan(scenario, designed, seed, direct_encoder=True)
    return sweeps, [spectrum(robot, sweep) for sweep in sweeps]


def free_poses(robot: Robot, rng: np.random.Generator, count: int) -> np.ndarray:
    """Random collision-free poses with room for a sweep."""
    lower, upper = joint_ranges(robot.chain)
    poses = rng.uniform(lower + 0.1, upper - 0.1, (20 * count, len(lower)))
    return poses[checker(robot).collision_free(poses)][:count]


def deviation(both: JointEstimate, scenario: Scenario) -> np.ndarray:
    """Identified less true value of every base parameter, in its standard deviations."""
    links = read_chain(real_urdf(scenario)).inertial.ravel()
    trains = [scenario.driven(joint).train for joint in both.robot.joints]
    motors = [t.motor_inertia * a.gear_ratio**2 for t, a in zip(trains, both.robot.axes, strict=True)]
    viscous = [t.motor_friction.viscous + t.load_friction.viscous for t in trains]
    dry = [t.motor_friction.coulomb + t.load_friction.coulomb for t in trains]
    truth = both.base.combination @ np.concatenate([links, motors, viscous, dry, np.zeros(len(trains))])
    return (both.solution.values - truth) / both.solution.std


def prediction(both: JointEstimate, record: TrajectoryRecord, sweeps: Sequence[Sweep]) -> dict[str, list[float]]:
    """By axis, RMS in percent of the rated effort: of every sample, and below 10 Hz."""
    robot = both.robot
    first, count = window(sweeps[0].spec, sweeps[0].recording.time)
    samples = count // record.periods
    fine = 8 * samples
    efforts = both.effort(record.motion(robot, fine, load=True), record.motion(robot, fine, load=False))
    harmonics = np.fft.rfft(efforts, axis=0)[: len(record.frequency)] / fine
    result: dict[str, list[float]] = {}
    for k, (track, sweep) in enumerate(zip(record.tracks, sweeps, strict=True)):
        rated = robot.axis(track.joint).rated_effort
        error = sweep.recording.effort[first : first + count] - np.tile(efforts[::8, k], record.periods)
        left = np.abs(harmonics[:, k] - track.effort) ** 2
        result[track.joint] = [
            100 * float(np.sqrt(np.mean(error**2))) / rated,
            100 * float(np.sqrt(left[0] + 2 * left[1:].sum())) / rated,
        ]
    return result


def records(robot: Robot, measured: Sequence[Sequence[Sweep]]) -> list[TrajectoryRecord]:
    return [trajectory(robot, [axis_track(sweep) for sweep in sweeps]) for sweeps in measured]
