"""The sweeps of the chosen poses along the path through them, each with its legs, its limits and its duration.

The first pose begins with the warm-up: rounds of its sweeps that are recorded but not used for the inertias.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from drivers.ports import SweepMode
from service.identification.design.excitation import Excitation, realisations
from service.model.errors import BadInput, EnvelopeViolation
from service.model.recording import Sine, SweepPurpose, SweepSpec
from service.model.robot import Robot
from service.planning.documents import DroppedPose, PlannedLeg, PlannedSweep, PlanRequest
from service.planning.safety.envelope import Envelope
from service.planning.safety.travel import order_poses

Array = NDArray[np.float64]

LEG_OVERHEAD = 1.0  # s to switch an axis on, settle and switch it off


@dataclass(frozen=True)
class ChosenPose:
    """`pose` (n,), the condition number with it (inf while singular), and the sweeps of the request's axes."""

    pose: Array
    condition: float
    sweeps: tuple[Excitation, ...]


@dataclass(frozen=True)
class _Run:
    """One sweep of a pose."""

    joint: str
    excitation: Excitation
    purpose: SweepPurpose = SweepPurpose.INERTIA
    repeat: int = 0


class SweepSequence:
    """Plans the path through chosen poses."""

    def __init__(self, robot: Robot, request: PlanRequest, envelope: Envelope) -> None:
        self._robot, self._request, self._envelope = robot, request, envelope

    def through(
        self, chosen: Sequence[ChosenPose], home: Array
    ) -> tuple[tuple[PlannedSweep, ...], tuple[DroppedPose, ...]]:
        """Sweeps of all axes in each of the poses on a short path from home; and the omitted poses."""
        here = [float(position) for position in home]
        streamed: set[str] = set()  # axes that already have their host-streamed sweep
        sweeps: list[PlannedSweep] = []
        dropped: list[DroppedPose] = []
        clock = 0.0
        for one in _in_order(chosen, home):
            goal = tuple(float(position) for position in one.pose)
            warm_up = () if sweeps else self._warm_up(one.sweeps)
            try:
                runs = (*warm_up, *self._measuring(one.pose, one.sweeps))
                planned, end = self._pose(here, goal, runs, streamed, len(sweeps), clock)
            except (EnvelopeViolation, BadInput) as error:
                dropped.append(DroppedPose(pose=goal, reason=str(error)))
                continue
            streamed |= {sweep.spec.axis for sweep in planned if sweep.mode is SweepMode.HOST_STREAMED}
            here, clock = end, clock + sum(sweep.duration for sweep in planned)
            sweeps += planned
        return tuple(sweeps), tuple(dropped)

    def _runs(self, excitations: Sequence[Excitation]) -> list[_Run]:
        """One sweep of each axis."""
        return [_Run(joint, sweep) for joint, sweep in zip(self._request.axes, excitations, strict=True)]

    def _measuring(self, pose: Array, excitations: Sequence[Excitation]) -> list[_Run]:
        """The sweeps in all their realisations; each pose and axis has its own phases."""
        place = [round(1e4 * float(position)) % 2**32 for position in pose]
        return [
            replace(run, excitation=one)
            for run in self._runs(excitations)
            for one in realisations(run.excitation, self._request.realisations, [self._robot.index(run.joint), *place])
        ]

    def _warm_up(self, excitations: Sequence[Excitation]) -> list[_Run]:
        """Complete rounds of all axes for the requested time."""
        rounds = math.ceil(self._request.warm_up / least_duration(excitations))
        return [
            replace(run, purpose=SweepPurpose.WARM_UP, repeat=n)
            for n in range(rounds)
            for run in self._runs(excitations)
        ]

    def _pose(
        self,
        here: list[float],
        goal: tuple[float, ...],
        runs: Sequence[_Run],
        streamed: set[str],
        number: int,
        clock: float,
    ) -> tuple[list[PlannedSweep], list[float]]:
        """The sweeps of one pose, and the final position of the robot."""
        planned: list[PlannedSweep] = []
        for run in runs:
            joint, excitation = run.joint, run.excitation
            legs = self._envelope.order_of_legs(here, goal)
            sweep = self._sweep(f"{number + len(planned) + 1:04d}", goal, run, self._mode(run, streamed))
            self._envelope.check_sweep(sweep.command(), goal)
            way = sum(abs(target - position) for position, target in _moves(here, legs))
            travelling = way / self._request.move_velocity + LEG_OVERHEAD * (len(legs) + 1)
            sweep = sweep.model_copy(
                update={
                    "legs": tuple(PlannedLeg(joint=self._robot.joints[k], target=target) for k, target in legs),
                    "spec": sweep.spec.model_copy(update={"started_at": clock + travelling}),
                    "duration": travelling + excitation.duration,
                }
            )
            clock += sweep.duration
            here = list(goal)
            here[self._robot.index(joint)] += excitation.travel
            planned.append(sweep)
        return planned, here

    def _mode(self, run: _Run, streamed: set[str]) -> SweepMode:
        modes = self._request.modes
        first = run.purpose is SweepPurpose.INERTIA and run.joint not in streamed
        if modes == "host_streamed" or (modes == "one_host_streamed" and first):
            return SweepMode.HOST_STREAMED
        return SweepMode.DRIVE_SIDE

    def _sweep(self, name: str, pose: tuple[float, ...], run: _Run, mode: SweepMode) -> PlannedSweep:
        """The sweep with its limits, without legs."""
        joint, excitation = run.joint, run.excitation
        envelope, index = self._envelope, self._robot.index(joint)
        sway = sum(sine.amplitude / (math.pi * sine.frequency) for sine in excitation.sines)
        margin = envelope.limits.window_margin + sway
        start, end = pose[index], pose[index] + excitation.travel
        return PlannedSweep(
            spec=SweepSpec(
                id=name,
                axis=joint,
                pose=pose,
                offset_velocity=excitation.offset_velocity,
                sines=tuple(
                    Sine(frequency=sine.frequency, amplitude=sine.amplitude, phase=sine.phase)
                    for sine in excitation.sines
                ),
                period=excitation.period,
                periods=excitation.periods,
                measure_from=excitation.measure_from,
                sample_rate=self._request.sample_rate,
                repeat=run.repeat,
                block=_label(run),
            ),
            mode=mode,
            ramp=excitation.ramp,
            settle=excitation.settle,
            velocity_limit=envelope.velocity_limit(index),
            effort_limit=envelope.effort_limit(index),
            position_window=(min(start, end) - margin, max(start, end) + margin),
            legs=(),
            duration=excitation.duration,
        )


def least_duration(sweeps: Sequence[Excitation]) -> float:
    """The time for a pose without the path to it, s: its sweeps, each with its way back and switching on and off."""
    return sum(sweep.duration + 2 * LEG_OVERHEAD for sweep in sweeps)


def _in_order(chosen: Sequence[ChosenPose], home: Array) -> list[ChosenPose]:
    """A short path through the poses that make the matrix regular, then one through the others."""
    singular = sum(not math.isfinite(one.condition) for one in chosen)
    here = home
    ordered: list[ChosenPose] = []
    for part in (chosen[: singular + 1], chosen[singular + 1 :]):
        if part:
            poses = np.array([one.pose for one in part])
            ordered += [part[k] for k in order_poses(poses, here)]
            here = ordered[-1].pose
    return ordered


def _label(run: _Run) -> str:
    if run.purpose is SweepPurpose.WARM_UP:
        return run.purpose.value
    return "forward" if run.excitation.offset_velocity > 0 else "backward"


def _moves(here: Sequence[float], legs: Sequence[tuple[int, float]]) -> list[tuple[float, float]]:
    """Start and target of each leg."""
    pose = list(here)
    moves: list[tuple[float, float]] = []
    for joint, target in legs:
        moves.append((pose[joint], target))
        pose[joint] = target
    return moves
