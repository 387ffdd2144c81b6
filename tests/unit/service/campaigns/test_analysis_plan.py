"""Plan of an initial analysis: spread of the poses, to and fro, limits of a noise run, sines in its stead."""

import json
from dataclasses import replace
from math import nan
from pathlib import Path

import numpy as np
import pytest

from drivers.ports import NoiseCommand, SweepCommand
from service.identification.axis.ideal_frequency import (
    IdealFrequency,
    InitialAnalysis,
    PoseAnalysis,
    Uncertain,
)
from service.identification.model.regressor import inertia_rows
from service.identification.spectra.noise_response import FrequencyResponse
from service.model.configuration import Cell, read_cell
from service.model.errors import BadInput, EnvelopeViolation
from service.model.robot import Robot
from service.planning.analysis import build_analysis_plan
from service.planning.documents import AnalysisPlan, AnalysisRequest, PlanRequest
from service.planning.plan import build_plan
from service.planning.safety.envelope import Envelope, noise_effort, noise_velocity, noise_way
from tests.unit.service.campaigns.small_arm import small_arm

REQUEST = {"kind": "analysis", "robot_id": 1, "axes": ("joint_1", "joint_3"), "varied": ("joint_2", "joint_3")}


@pytest.fixture(scope="module")
def cell(root: Path) -> Cell:
    return read_cell(root / "config/cells/workshop.yaml")


@pytest.fixture(scope="module")
def plan(robot: Robot, cell: Cell) -> AnalysisPlan:
    return build_analysis_plan(robot, AnalysisRequest.model_validate(REQUEST | {"step": 15.0}), cell)


def test_poses_run_from_light_to_heavy(plan: AnalysisPlan, robot: Robot) -> None:
    poses = {sweep.spec.pose[1:] for sweep in plan.sweeps if sweep.spec.axis == "joint_1"}
    inertia = inertia_rows(robot.chain, 0, np.array([(0.0, *pose) for pose in poses])) @ robot.chain.inertial.ravel()
    assert len(poses) == 6
    assert inertia.max() > 4 * inertia.min()
    assert np.diff(np.sort(np.log(inertia))).max() < 0.5


def test_each_pose_is_swept_to_and_fro_over_the_same_travel(plan: AnalysisPlan) -> None:
    assert len(plan.sweeps) == 2 * 6 * 4
    first = [sweep.spec for sweep in plan.sweeps[:4]]
    assert [spec.block for spec in first] in (
        ["noise_forward", "noise_backward"] * 2,
        ["noise_backward", "noise_forward"] * 2,
    )
    assert first[0].pose == pytest.approx(first[2].pose)
    assert {spec.excitation for spec in first} == {"noise"}
    commands = [sweep.command() for sweep in plan.sweeps]
    assert len({one.seed for one in commands if isinstance(one, NoiseCommand)}) == len(plan.sweeps)
    assert all(sweep.duration > sweep.command().duration for sweep in plan.sweeps)


def test_commands_are_the_papers(plan: AnalysisPlan, robot: Robot) -> None:
    for sweep in plan.sweeps:
        command = sweep.command()
        assert isinstance(command, NoiseCommand)
        assert 0.85 * 0.01047 < abs(command.offset_velocity) <= 0.010472
        assert 0 < command.effort <= 0.01 * robot.axis(command.joint).rated_effort
        assert command.highest < 40


@pytest.mark.slow
def test_the_plan_survives_json(plan: AnalysisPlan) -> None:
    assert AnalysisPlan.model_validate(json.loads(plan.model_dump_json())) == plan


def test_a_stepped_sine_takes_every_line_in_every_pose(robot: Robot, cell: Cell) -> None:
    wanted = REQUEST | {"step": 15.0, "excitation": "stepped_sine", "poses": 2, "repeats": 1}
    sweeps = build_analysis_plan(robot, AnalysisRequest.model_validate(wanted), cell).sweeps
    assert len(sweeps) == 2 * 2 * 4
    assert all(isinstance(sweep.command(), SweepCommand) for sweep in sweeps)
    assert all(sweep.spec.stepped and not sweep.spec.shows_inertia for sweep in sweeps)
    assert sorted(sine.frequency for sweep in sweeps[:4] for sine in sweep.spec.sines) == list(range(1, 17))


@pytest.mark.parametrize(
    ("change", "place"),
    [({"axes": ("joint_9",)}, "axes"), ({"poses": 100, "step": 60.0}, "poses"), ({"varied": ("x",)}, "varied")],
)
def test_requests_that_cannot_be_met(robot: Robot, cell: Cell, change: dict[str, object], place: str) -> None:
    with pytest.raises(BadInput) as refused:
        build_analysis_plan(robot, AnalysisRequest.model_validate(REQUEST | change), cell)
    assert refused.value.place == place


COMMAND = NoiseCommand(
    joint="j1",
    offset_velocity=0.01,
    effort=5.0,
    lowest=1.0,
    highest=39.0,
    period=1.6,
    periods=3,
    seed=1,
    softening=0.4,
    ramp=0.5,
    settle=1.0,
    sample_rate=250.0,
    velocity_limit=0.1,
    effort_limit=2000.0,
    position_window=(-0.51, -0.43),
)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"offset_velocity": 0.02}, r"j1: travel .* rad is above the limit"),
        ({"offset_velocity": nan}, "not finite"),
        ({"effort": 0.0}, "effort of the sweep is 0.0"),
        ({"effort": 400.0}, "j1: (travel|predicted peak effort|peak velocity) .* is above the limit"),
        ({"lowest": 0.0}, "lowest frequency of the sweep is 0.0"),
        ({"highest": 0.5}, "width of the band of the sweep is -0.5"),
        ({"sample_rate": 60.0}, "distance of the band from half the sample rate of the sweep is -9.0"),
        ({"softening": 0.0}, "softening of the sweep is 0.0"),
        ({"softening": 1.5}, "softening 1.5 of the gain is above the limit 1"),
        ({"effort_limit": 300.0}, "predicted peak effort"),
        ({"position_window": (-0.501, -0.43)}, "lowest position of the sweep"),
    ],
)
def test_the_envelope_of_a_noise_run(change: dict[str, object], message: str) -> None:
    envelope = Envelope(small_arm(), Cell(name="test", floor=0.0, joint_margin=0.02))
    envelope.check_sweep(COMMAND, (-0.5, 0.3))
    with pytest.raises(EnvelopeViolation, match=message):
        envelope.check_sweep(replace(COMMAND, **change), (-0.5, 0.3))


def test_the_bounds_hold_for_any_phases() -> None:
    rng = np.random.default_rng(1)
    lines, inertia = np.arange(2, 63) / 1.6, 80.0
    time = np.arange(1600) / 1000.0
    for _ in range(20):
        phases = rng.uniform(0, 2 * np.pi, (len(lines), 1))
        waves = np.exp(1j * (2 * np.pi * lines[:, None] * time + phases)) * 5.0 * np.sqrt(2 / len(lines))
        omega = 2 * np.pi * lines[:, None]
        assert np.abs(waves.real.sum(axis=0)).max() <= noise_effort(COMMAND)
        assert np.abs((waves / omega).real.sum(axis=0)).max() / inertia <= noise_velocity(COMMAND, inertia)
        assert np.abs((waves / omega**2).real.sum(axis=0)).max() / inertia <= noise_way(COMMAND, inertia)


def test_a_plan_of_sweeps_stands_on_the_analysis(robot: Robot, cell: Cell) -> None:
    """Lines stay below the resonance that was found, pose by pose."""
    mean = np.array([58.0, 140.0, 60.0, 1 / 7.4e5, 1.2e-3])
    nothing = FrequencyResponse(
        np.array([1.0]), np.ones(1, complex), np.ones(1, complex), np.zeros((1, 2, 2), complex), np.ones(1)
    )
    figures = [Uncertain(value, 1.0) for value in (250.0, 200.0, 8.0, 0.2, 2.4)]
    pose = PoseAnalysis((0.0,) * 6, nothing, 192.0, IdealFrequency(*figures), IdealFrequency(*figures))
    analyses = {"joint_1": InitialAnalysis("joint_1", mean, np.diag((0.01 * mean) ** 2), 1.0, (pose,))}
    request = PlanRequest(robot_id=1, axes=("joint_1",), varied=("joint_2", "joint_3"), step=20.0, poses=8, analysis=1)
    found = build_plan(robot, request, cell, analyses)
    for sweep in found.sweeps:
        load = inertia_rows(robot.chain, 0, np.array([sweep.spec.pose]))[0] @ robot.chain.inertial.ravel()
        resonance = np.sqrt(7.4e5 / load) / (2 * np.pi)
        lines = [sine.frequency for sine in sweep.spec.sines]
        assert lines == [line for line in (2.0, 3.0, 4.0, 5.0) if line <= 0.75 * resonance or line == 2.0]
    assert {len(sweep.spec.sines) for sweep in found.sweeps} > {4}
