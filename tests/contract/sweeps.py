"""Sweeps of known lines on a machine, their sample indices, their inertias."""

import time
from collections.abc import Mapping, Sequence
from contextlib import aclosing
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import yaml
from numpy.typing import NDArray

from drivers.ports import DrivePort, SampleBlock, SineCommand, SweepCommand, SweepMode
from service.identification.estimates.estimate import identify
from service.identification.spectra.frequency_response import spectrum
from service.model import Recording, Robot, RobotDescription, Sine, Sweep, SweepSpec, build_robot

ROBOT = Path(__file__).parents[2] / "config" / "robots" / "max100-class.yaml"
# Hz; each axis has lines of its own, so that on a real arm what one axis does to another shows at neither's lines
LINES = {"joint_1": (2.0, 4.0), "joint_2": (2.5, 4.5), "joint_3": (3.0, 5.0)}
POSE = {"joint_1": 0.0, "joint_2": -0.3, "joint_3": 0.72}  # rad, where sweeps begin or end; forearm level
PERIOD, PERIODS = 2.0, 3  # s: all lines are whole in it
RAMP = SETTLE = 0.5  # s
MOVING = RAMP + SETTLE + PERIOD * PERIODS  # s of the offset's full velocity
TRAVEL = np.radians(4.0)
SHARE = 0.28  # of the offset for each line; twice that and an elastic load still does not reverse
WIDE = 0.3  # rad that a wide sweep travels: a line is then more than 20 steps of a Powerball's position
VELOCITY = 0.5  # rad/s, of moves

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Run:
    """One `run_sweep`: of each axis what was commanded and delivered."""

    mode: SweepMode
    sweeps: Mapping[str, Sweep]
    gapless: bool  # the drive's sample counter was 0, 1, 2, ... on every axis


@dataclass(frozen=True)
class Comparison:
    """Inertia of one axis, kg m^2: host-streamed against drive-side sweeps of the same pose, with covariance."""

    streamed: float
    drive_side: float
    difference_std: float
    std: float  # of one streamed sweep, median

    @property
    def z(self) -> float:
        return (self.streamed - self.drive_side) / self.difference_std


def robot() -> Robot:
    description = RobotDescription.model_validate(yaml.safe_load(ROBOT.read_text("utf-8")))
    return build_robot(description, (ROBOT.parent / description.urdf).read_text("utf-8"))


def command(robot: Robot, joint: str, start: float, forward: bool, mode: SweepMode, rate: float) -> SweepCommand:
    """A sweep of `joint` from `start`, rad."""
    offset = _offset(robot, joint, TRAVEL)
    return SweepCommand(
        joint=joint,
        mode=mode,
        offset_velocity=offset if forward else -offset,
        sines=_sines(joint, offset),
        period=PERIOD,
        periods=PERIODS,
        ramp=RAMP,
        settle=SETTLE,
        sample_rate=rate,
        velocity_limit=0.05,
        effort_limit=3000.0,
        position_window=(start - 0.1, start + 0.1),
    )


def wide(robot: Robot, joint: str, start: float, mode: SweepMode, rate: float) -> SweepCommand:
    """A forward sweep that turns further and faster."""
    offset = _offset(robot, joint, WIDE)
    return replace(
        command(robot, joint, start, True, mode, rate),
        offset_velocity=offset,
        sines=_sines(joint, offset),
        velocity_limit=0.2,
        position_window=(start - 0.45, start + 0.45),
    )


async def run(port: DrivePort, robot: Robot, commands: Sequence[SweepCommand], pose: Mapping[str, float]) -> Run:
    """Enable, sweep, disable. `pose`: where the joints are on the average of the sweep, rad."""
    blocks: dict[str, list[SampleBlock]] = {each.joint: [] for each in commands}
    await port.enable(*blocks)
    name = f"{time.time():.3f}"
    async with aclosing(port.run_sweep(*commands)) as samples:
        async for block in samples:
            blocks[block.joint].append(block)
    for joint in blocks:
        await port.disable(joint)
    return Run(
        mode=commands[0].mode,
        sweeps={each.joint: _sweep(robot, each, blocks[each.joint], pose, name) for each in commands},
        gapless=all(np.array_equal(_index(own), np.arange(len(_index(own)))) for own in blocks.values()),
    )


async def move(port: DrivePort, pose: Mapping[str, float]) -> None:
    """One joint after the other, to rad."""
    for joint, target in pose.items():
        await port.enable(joint)
        await port.move_to(joint, target, VELOCITY)
        await port.disable(joint)


def compare(robot: Robot, runs: Sequence[Run], joint: str) -> Comparison:
    """All sweeps of an axis identified together; difference of the two kinds with the covariance between them."""
    mine = sorted((run for run in runs if joint in run.sweeps), key=lambda run: run.sweeps[joint].spec.id)
    (axis,) = identify(robot, [spectrum(robot, run.sweeps[joint]) for run in mine]).axes
    values, covariance = np.array([sweep.value for sweep in axis.sweeps]), axis.covariance
    streamed = np.array([run.mode is SweepMode.HOST_STREAMED for run in mine])
    means = streamed / streamed.sum(), ~streamed / (~streamed).sum()
    return Comparison(
        streamed=float(means[0] @ values),
        drive_side=float(means[1] @ values),
        difference_std=float(np.sqrt((means[0] - means[1]) @ covariance @ (means[0] - means[1]))),
        std=float(np.median(np.sqrt(np.diag(covariance)[streamed]))),
    )


def _index(blocks: Sequence[SampleBlock]) -> NDArray[np.integer]:
    return np.concatenate([block.index for block in blocks])


def _sines(joint: str, offset: float) -> tuple[SineCommand, ...]:
    phases = (0.0, -np.pi / 2)
    return tuple(SineCommand(f, SHARE * offset, phase) for f, phase in zip(LINES[joint], phases, strict=True))


def _offset(robot: Robot, joint: str, travel: float) -> float:
    """The fastest offset within `travel`, rad, that keeps cogging off the lines (see `excitation`), rad/s."""
    axis = robot.axis(joint)
    step = 2 * np.pi / (axis.cogging_orders[0] * axis.gear_ratio * PERIOD * PERIODS)
    return float(next(n for n in range(int(travel / MOVING / step), 0, -1) if n % PERIODS) * step)


def _sweep(
    robot: Robot, command: SweepCommand, blocks: list[SampleBlock], pose: Mapping[str, float], name: str
) -> Sweep:
    def column(field: str) -> Array:
        return np.concatenate([getattr(block, field) for block in blocks])

    start = float(blocks[0].position[0])
    spec = SweepSpec(
        id=f"{name} {command.joint}",
        axis=command.joint,
        pose=tuple(start if joint == command.joint else pose.get(joint, 0.0) for joint in robot.joints),
        offset_velocity=command.offset_velocity,
        sines=tuple(Sine(frequency=s.frequency, amplitude=s.amplitude, phase=s.phase) for s in command.sines),
        period=command.period,
        periods=command.periods,
        measure_from=command.measure_from,
        sample_rate=command.sample_rate,
        started_at=float(name),
    )
    fields = ("time", "effort", "velocity", "position", "velocity_setpoint")
    return Sweep(spec, Recording(**{field: column(field) for field in fields}))
