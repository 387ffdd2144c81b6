"""Plans an initial analysis (paper, section 4.1): several poses of each axis, with noise in both directions.

The poses are those of the grid whose inertia about the axis (CAD model) is nearest to equal logarithmic steps, from the
lightest to the heaviest measurable pose. A drive without torque injection gets a stepped
sine instead: sweeps of four lines each, which together contain every integer frequency in Hz of `STEPPED_LINES`.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from drivers.ports import SweepMode
from service.identification.design.excitation import Excitation, NoiseExcitation, design_noise, design_sweep
from service.identification.model.regressor import inertia_rows
from service.model.configuration import Cell
from service.model.errors import BadInput, EnvelopeViolation
from service.model.recording import Sine, SweepPurpose, SweepSpec
from service.model.robot import Robot
from service.planning.analysis.documents import AnalysisPlan, AnalysisRequest, PlannedNoise
from service.planning.candidates import grid, has_room, room
from service.planning.documents import DroppedPose, PlannedLeg, PlannedSweep
from service.planning.safety.envelope import Envelope
from service.planning.safety.noise_motion import noise_way
from service.planning.safety.travel import order_poses
from service.planning.sweep_design import TRAVEL_SHARE
from service.planning.sweep_sequence import LEG_OVERHEAD

Array = NDArray[np.float64]
Run = PlannedNoise | PlannedSweep

STEPPED_LINES = tuple(tuple(float(line) for line in range(first, 17, 4)) for first in range(1, 5))  # Hz, sweep by sweep
STEP_SHARE = 0.25  # of normal amplitudes: at frequencies where the motor hardly moves, the load does


def build_analysis_plan(robot: Robot, request: AnalysisRequest, cell: Cell) -> AnalysisPlan:
    """The plan of an initial analysis; BadInput names the field that is impossible."""
    as_sweeps = request.as_sweeps()
    as_sweeps.check(robot)
    envelope = Envelope(robot, cell)
    home = np.array(cell.home_pose(robot.joints))
    poses = grid(robot, as_sweeps, envelope, home)
    free = poses[envelope.checker.collision_free(poses)]
    axes = [robot.index(joint) for joint in request.axes]
    candidates = free[has_room(envelope, free, axes)]
    if len(candidates) < request.poses:
        raise BadInput(
            "poses",
            f"{request.poses} requested, but only {len(candidates)} poses of the grid are collision-free and have room "
            "for the sweeps: request fewer poses, or a smaller step",
        )
    way = _Way(robot, request, envelope, home)
    for index in axes:
        chosen = spread_poses(robot, index, candidates, request.poses)
        for pose in chosen[order_poses(chosen, np.array(way.here))]:
            way.measure(index, pose)
    if not way.sweeps:
        raise BadInput("poses", f"no pose can be measured; reason for the first: {way.dropped[0].reason}")
    return AnalysisPlan(
        robot=robot.name,
        request=request,
        sweeps=tuple(way.sweeps),
        dropped=tuple(way.dropped),
        candidates=len(poses),
        measurable=len(candidates),
        duration=sum(sweep.duration for sweep in way.sweeps),
    )


def spread_poses(robot: Robot, index: int, candidates: Array, count: int) -> Array:
    """`count` of the poses (m, n), from the smallest to the largest inertia about joint `index`."""
    inertia = np.log(inertia_rows(robot.chain, index, candidates) @ robot.chain.inertial.ravel())
    left = np.ones(len(candidates), dtype=bool)
    picks: list[int] = []
    for wanted in np.linspace(float(inertia.min()), float(inertia.max()), count).tolist():
        pick = int(np.argmin(np.where(left, np.abs(inertia - wanted), np.inf)))
        left[pick] = False
        picks.append(pick)
    return candidates[picks]


class _Way:
    """Collects the runs in order."""

    def __init__(self, robot: Robot, request: AnalysisRequest, envelope: Envelope, home: Array) -> None:
        self._robot, self._request, self._envelope = robot, request, envelope
        self.here: list[float] = home.tolist()
        self.sweeps: list[Run] = []
        self.dropped: list[DroppedPose] = []
        self._clock = 0.0

    def measure(self, index: int, pose: Array) -> None:
        """All runs of an axis in a pose, forward and backward over the same travel; else the reason for none."""
        here, count, clock = list(self.here), len(self.sweeps), self._clock
        direction = 1 if room(self._envelope, pose[None], index, 1)[0] else -1
        start: list[float] = pose.tolist()
        try:
            for lines in self._runs():
                design = self._design(index, start, direction, lines)
                self._add(index, tuple(start), design)
                start[index] += design.travel
                direction = -direction
        except (EnvelopeViolation, BadInput) as error:
            self.here, self._clock = here, clock
            del self.sweeps[count:]
            self.dropped.append(DroppedPose(pose=tuple(pose.tolist()), reason=str(error)))

    def _runs(self) -> tuple[tuple[float, ...], ...]:
        """The lines of each run in a pose; () for noise."""
        once = STEPPED_LINES if self._request.excitation == "stepped_sine" else ((), ())
        return once * self._request.repeats

    def _design(
        self, index: int, start: Sequence[float], direction: int, lines: tuple[float, ...]
    ) -> NoiseExcitation | Excitation:
        robot, joint, envelope = self._robot, self._robot.joints[index], self._envelope
        load = float(inertia_rows(robot.chain, index, np.array([start]))[0] @ robot.chain.inertial.ravel())
        travel = TRAVEL_SHARE * envelope.limits.travel
        if not lines:
            inertia = load + (robot.axes[index].reflected_motor_inertia or 0.0)
            number = len(self.sweeps) + 1
            return design_noise(robot, joint, inertia=inertia, travel=travel, seed=number, direction=direction)
        velocity = envelope.velocity_limit(index)
        usual = design_sweep(
            robot,
            joint,
            np.array(start),
            load_inertia=load,
            lines=lines,
            direction=direction,
            travel=travel,
            velocity_limit=velocity,
        )
        return replace(usual, sines=tuple(_smaller(sine) for sine in usual.sines))

    def _add(self, index: int, start: tuple[float, ...], design: NoiseExcitation | Excitation) -> None:
        legs = self._envelope.order_of_legs(self.here, start)
        pose, way = list(self.here), 0.0
        for joint, target in legs:
            way += abs(target - pose[joint])
            pose[joint] = target
        travelling = way / self._request.move_velocity + LEG_OVERHEAD * (len(legs) + 1)
        planned = (
            self._noise(index, start, design)
            if isinstance(design, NoiseExcitation)
            else self._sines(index, start, design)
        )
        self._envelope.check_sweep(planned.command(), start)
        self.sweeps.append(
            planned.model_copy(
                update={
                    "legs": tuple(PlannedLeg(joint=self._robot.joints[k], target=target) for k, target in legs),
                    "spec": planned.spec.model_copy(update={"started_at": self._clock + travelling}),
                    "duration": travelling + design.duration,
                }
            )
        )
        self._clock += self.sweeps[-1].duration
        self.here = list(start)
        self.here[index] += design.travel

    def _noise(self, index: int, start: tuple[float, ...], design: NoiseExcitation) -> PlannedNoise:
        envelope = self._envelope
        planned = PlannedNoise(
            spec=self._spec(index, start, design, "noise").model_copy(update={"excitation": "noise"}),
            effort=design.effort,
            lowest=design.lowest,
            highest=design.highest,
            seed=design.seed,
            softening=design.softening,
            ramp=design.ramp,
            settle=design.settle,
            velocity_limit=envelope.velocity_limit(index),
            effort_limit=envelope.effort_limit(index),
            position_window=(0.0, 0.0),
            legs=(),
            duration=design.duration,
        )
        sway = noise_way(planned.command(), envelope.least_inertia(index, start))
        return planned.model_copy(update={"position_window": self._window(index, start, design.travel, sway)})

    def _sines(self, index: int, start: tuple[float, ...], design: Excitation) -> PlannedSweep:
        envelope = self._envelope
        sway = sum(sine.amplitude / (np.pi * sine.frequency) for sine in design.sines)
        return PlannedSweep(
            spec=self._spec(index, start, design, SweepPurpose.STEPPED_SINE.value).model_copy(
                update={"sines": design.sines}
            ),
            mode=SweepMode.DRIVE_SIDE,
            ramp=design.ramp,
            settle=design.settle,
            velocity_limit=envelope.velocity_limit(index),
            effort_limit=envelope.effort_limit(index),
            position_window=self._window(index, start, design.travel, sway),
            legs=(),
            duration=design.duration,
        )

    def _spec(
        self, index: int, start: tuple[float, ...], design: NoiseExcitation | Excitation, block: str
    ) -> SweepSpec:
        towards = "forward" if design.offset_velocity > 0 else "backward"
        return SweepSpec(
            id=f"{len(self.sweeps) + 1:04d}",
            axis=self._robot.joints[index],
            pose=start,
            offset_velocity=design.offset_velocity,
            period=design.period,
            periods=design.periods,
            measure_from=design.measure_from,
            sample_rate=self._request.sample_rate,
            block=f"{block}_{towards}",
        )

    def _window(self, index: int, start: tuple[float, ...], travel: float, sway: float) -> tuple[float, float]:
        margin = self._envelope.limits.window_margin + sway
        low, high = sorted((start[index], start[index] + travel))
        return low - margin, high + margin


def _smaller(sine: Sine) -> Sine:
    return sine.model_copy(update={"amplitude": STEP_SHARE * sine.amplitude})
