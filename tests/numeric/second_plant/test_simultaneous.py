"""M_kj(q) and base parameters from simultaneous sweeps of a plant that the estimator's code does not make.

`python -m tests.numeric.second_plant.test_simultaneous AXES SWEEPS SEED...` prints the figures of further robots. Seeds
below 100 were used while the method was made.
"""

import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import pytest
from numpy.typing import NDArray

from service.identification.axis.drive_train import TwoMassTrain
from service.identification.design.excitation import (
    Excitation,
    design_sweep,
    realisations,
    velocity_setpoint,
    zippered_lines,
)
from service.identification.estimates.combination import AxisInertias, JointEstimate, combination_document, combine
from service.identification.estimates.estimate import identify
from service.identification.model import axis_rows, nominal_parameters, prior_information
from service.identification.motion.trajectory_record import TrajectoryRecord, axis_track, trajectory
from service.identification.spectra.frequency_response import spectrum
from service.model import Recording, Sweep, SweepSpec, build_robot
from service.model.configuration import Cell
from service.planning.documents import at_once
from service.planning.plan import build_plan
from tests.numeric.second_plant.machine import STEP
from tests.numeric.second_plant.robot_time import records, request
from tests.numeric.second_plant.robots import urdf
from tests.numeric.second_plant.simultaneous import RATE, Arm, arm, run

Array = NDArray[np.float64]

pytestmark = pytest.mark.slow


@dataclass(frozen=True)
class Score:
    """Errors over poses of the workspace: `diagonal` relative to J, `off_diagonal` to the largest J of the pose; `z`,
    errors over std: of both, and of the base parameters that inertias about single axes leave undetermined.
    """

    diagonal: Array
    off_diagonal: Array
    z_diagonal: Array
    z_off_diagonal: Array
    z_new: Array


def measured(
    plant: Arm, moving: Sequence[int], pose: Array, seed: int, *, sticking: int | None = None
) -> TrajectoryRecord:
    """One simultaneous sweep; the axis `sticking` oscillates with 1.5 times its offset, so that it stands again and
    again.
    """
    random = np.random.default_rng([7, seed])
    joints = [plant.robot.joints[k] for k in moving]
    window, lines = zippered_lines(len(moving))
    runs: list[Excitation] = []
    for k, joint, own in zip(moving, joints, lines, strict=True):
        designed = design_sweep(
            plant.robot,
            joint,
            pose,
            load_inertia=float(np.diag(plant.matrix(pose))[k]),
            lines=own,
            window=window,
            direction=int(random.choice([-1, 1])),
            locked_rotor_frequency=None if np.isinf(plant.locked[k]) else float(plant.locked[k]),
        )
        runs.append(realisations(designed, 2, [seed, k])[0])
    if sticking is not None:
        own = runs[moving.index(sticking)]
        sines = tuple(sine.model_copy(update={"amplitude": 1.9 * sine.amplitude}) for sine in own.sines)
        runs[moving.index(sticking)] = Excitation(
            own.offset_velocity, sines, own.period, own.periods, own.ramp, own.settle
        )
    steps = STEP * np.arange(round(runs[0].duration / STEP), dtype=np.float64)
    wanted = np.stack([velocity_setpoint(own, steps) for own in runs], -1)
    time, torque, position = run(plant, moving, pose, wanted, random)
    tracks = [
        axis_track(
            Sweep(
                SweepSpec(
                    id=f"{seed}-{joint}", axis=joint, pose=tuple(pose.tolist()), offset_velocity=own.offset_velocity,
                    excitation="trajectory", sines=own.sines, period=own.period, periods=1,
                    measure_from=own.measure_from, sample_rate=RATE, block=f"trajectory {seed} of {len(joints)} axes",
                ),
                Recording(time, torque[:, k], np.gradient(position[:, k], 1 / RATE), position[:, k]),
            )
        )
        for k, (joint, own) in enumerate(zip(joints, runs, strict=True))
    ]  # fmt: skip
    return trajectory(plant.robot, tracks)


def campaign(seed: int, axes: int, sweeps: int) -> Score:
    """Sweeps of all axes at once in random poses; in every third one a random axis sticks."""
    plant, random = arm(seed, axes), np.random.default_rng([seed, 5])
    limits = np.array([(joint.lower, joint.upper) for joint in plant.built.joints])
    low, high = limits[:, 0] + 0.4, limits[:, 1] - 0.4
    records = [
        measured(
            plant, range(axes), random.uniform(low, high), 100 * seed + k,
            sticking=None if k % 3 else int(random.integers(axes)),
        )
        for k in range(sweeps)
    ]  # fmt: skip
    analysed: list[AxisInertias] = []
    for joint, compliance in plant.compliance.items():
        k = plant.robot.index(joint)
        rotor, friction = float(plant.rotors[k]), float(plant.friction[k]) / 2
        std = np.array([0.1 * rotor, friction, 0.0, 0.02 * compliance, 0.002])
        train = TwoMassTrain(rotor, friction, friction, compliance, 0.0)
        analysed.append(AxisInertias(joint, np.zeros((0, axes)), np.zeros(0), np.zeros((0, 0)), train, 1.0, std))
    return score(plant, combine(plant.robot, analysed, records), random.uniform(low, high, (60, axes)))


def score(plant: Arm, found: JointEstimate, poses: Array) -> Score:
    values, std = found.inertia_matrix(poses)
    true = np.array([plant.matrix(pose) for pose in poses])
    diagonal, off = np.eye(len(plant.motor), dtype=bool), np.triu(np.ones(true.shape[1:], dtype=bool), 1)
    largest = np.diagonal(true, axis1=1, axis2=2).max(axis=1)[:, None]
    error, z = values - true, (values - true) / std
    new = _undetermined(found, poses)
    base = found.base.combination @ _true_parameters(plant)
    z_base = (found.solution.values - base) / found.solution.std
    return Score((error / true)[:, diagonal], error[:, off] / largest, z[:, diagonal], z[:, off], z_base[new])


def _true_parameters(plant: Arm) -> Array:
    parameters = nominal_parameters(build_robot(plant.robot.description, urdf(plant.built)))
    count = len(plant.motor)
    for part, own in ((10, plant.motor), (11, plant.viscous)):
        parameters[part * count : (part + 1) * count] = own
    return parameters


def _undetermined(found: JointEstimate, poses: Array) -> NDArray[np.intp]:
    """Inertial base parameters of which inertias of all axes in all `poses`, known to 0.3 %, say next to nothing."""
    robot, columns = found.robot, list(found.base.columns)
    prior = prior_information(robot, found.base)
    start = found.base.combination @ nominal_parameters(robot)
    alone = prior
    for index in range(len(robot.axes)):
        rows = axis_rows(robot.chain, index, poses)
        rows = np.hstack([rows, np.zeros((len(rows), 3 * len(robot.axes)))])[:, columns]
        alone = alone.add(rows, rows @ start, np.diag(np.square(0.003 * (rows @ start))))
    lost = alone.solve(start).std > 0.9 * prior.solve(start).std
    return np.flatnonzero(lost & (np.array(columns) < 11 * len(robot.axes)))


def test_the_inertia_matrix_and_what_single_axes_leave_open() -> None:
    scores = [campaign(seed, 3, 6) for seed in (101, 102)]
    for one in scores:
        assert np.quantile(np.abs(one.off_diagonal), 0.95) < 0.01
        assert np.quantile(np.abs(one.diagonal), 0.95) < 0.02
    assert np.mean(np.abs(np.concatenate([one.z_off_diagonal.ravel() for one in scores])) < 3) > 0.9
    assert np.mean(np.abs(np.concatenate([one.z_diagonal.ravel() for one in scores])) < 2) > 0.9
    new = np.concatenate([one.z_new for one in scores])
    assert len(new) >= 2
    assert np.sqrt(np.mean(np.square(new))) < 2


@pytest.mark.parametrize(
    ("seed", "dry", "noise", "limit"), [(3, 1e-9, 1e-6, 0.004), (3, 1e-9, 5.0, 0.07), (320, 1.0, 1e-6, 0.0015)]
)
def test_springs_explain_neither_friction_of_the_motor_nor_noise(
    seed: int, dry: float, noise: float, limit: float
) -> None:
    """With this part of the usual dry friction and noise; nobody has analysed the axes."""
    plant, random = arm(seed, 3), np.random.default_rng([seed, 5])
    limits = np.array([(joint.lower, joint.upper) for joint in plant.built.joints])
    quiet = replace(plant, dry=dry * plant.dry, rated=noise * plant.rated)
    poses = random.uniform(limits[:, 0] + 0.4, limits[:, 1] - 0.4, (65, 3))
    records = [measured(quiet, range(3), pose, 100 * seed + k) for k, pose in enumerate(poses[:5])]
    one = score(plant, combine(plant.robot, (), records), poses[5:])
    assert np.quantile(np.abs(one.diagonal), 0.95, axis=0).max() < limit


def test_no_axis_of_a_planned_sweep_stands() -> None:
    """The wrists of this arm are light: beside all other axes their motors stood again and again."""
    plant, random = arm(340, 6), np.random.default_rng(1)
    plan = build_plan(plant.robot, request(plant.robot, 6, duration=60.0, simultaneous=True), Cell(name="free"))
    pairs = at_once(plan.sweeps)
    assert len(pairs) > 2
    for pair in pairs:
        for sweep in records(plant, [plan.sweeps[number - 1] for number in pair], random):
            time = sweep.recording.time  # s; the heaviest dry friction yields 2 s after the start
            inside = (time > 2.5) & (time < (sweep.spec.measure_from or 0.0) + (sweep.spec.period or 0.0))
            assert (sweep.recording.velocity[inside] / sweep.spec.offset_velocity).min() > 0.1


def _stands() -> tuple[Arm, Array]:
    """An arm whose dry friction holds joint_6 for 1.2 s, beyond the start of each window, and poses."""
    plant = arm(502, 6)
    limits = np.array([(joint.lower, joint.upper) for joint in plant.built.joints])
    return plant, np.random.default_rng(4).uniform(limits[:, 0] + 0.4, limits[:, 1] - 0.4, (6, 6))


def test_friction_that_holds_an_axis_at_the_start_of_a_window_is_no_inertia() -> None:
    plant, _ = _stands()
    asked = request(plant.robot, 6, duration=400.0).model_copy(update={"axes": ("joint_6",)})
    plan, random = build_plan(plant.robot, asked, Cell(name="free")), np.random.default_rng(1)
    sweeps = [records(plant, [sweep], random)[0] for sweep in plan.sweeps]
    axis = identify(plant.robot, [spectrum(plant.robot, sweep) for sweep in sweeps]).axes[0]
    true = np.array([plant.matrix(np.array(sweep.spec.pose))[5, 5] for sweep in sweeps])
    assert np.abs(axis.values / true - 1).max() < 0.25
    assert np.all(np.abs(axis.values - true) < 3 * np.sqrt(np.diag(axis.covariance)))
    assert all("friction holds" in (sweep.warning or "") for sweep in axis.sweeps)


def test_an_axis_that_friction_holds_beside_others_is_told_and_not_identified() -> None:
    plant, poses = _stands()
    found = combine(plant.robot, (), [measured(plant, (4, 5), pose, 500 + k) for k, pose in enumerate(poses)])
    values, std = (np.diagonal(each, axis1=1, axis2=2) for each in found.inertia_matrix(poses))
    true = np.array([np.diag(plant.matrix(pose)) for pose in poses])
    assert np.all(np.abs(values - true)[:, 4:] < 3 * std[:, 4:])
    (told,) = combination_document(found).warnings
    assert told.startswith("friction holds joint_6 for up to 0.2")


if __name__ == "__main__":
    for number in sys.argv[3:]:
        one = campaign(int(number), int(sys.argv[1]), int(sys.argv[2]))
        print(
            f"seed {number}: J p95 {100 * np.quantile(np.abs(one.diagonal), 0.95):.2f} %, off-diagonal p95 "
            f"{100 * np.quantile(np.abs(one.off_diagonal), 0.95):.3f} %, within two std: J "
            f"{np.mean(np.abs(one.z_diagonal) < 2):.2f}, off-diagonal {np.mean(np.abs(one.z_off_diagonal) < 2):.2f}, "
            f"new base parameters {np.sum(np.abs(one.z_new) < 2)} of {len(one.z_new)}",
            flush=True,
        )
