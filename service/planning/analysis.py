"""Plans an initial analysis (paper, section 4.1): several poses of each axis, with noise in both directions.

The poses are those of the grid whose inertia about the axis (CAD model) is nearest to equal logarithmic steps, from the
lightest to the heaviest measurable pose. A drive without torque injection gets a stepped sine instead: sweeps of four
lines each, which together contain every integer frequency from 1 to 16 Hz.
"""

import numpy as np

from drivers.ports import SweepMode
from service import BadInput, EnvelopeViolation
from service.identification.design.excitation import Excitation, NoiseExcitation, design_noise, design_sweep
from service.identification.model import inertia_rows
from service.model import Array, Robot, SweepPurpose, SweepSpec
from service.model.configuration import Cell
from service.planning.documents import AnalysisPlan, AnalysisRequest, DroppedPose, PlannedNoise, PlannedSweep, grid_of
from service.planning.path import SweepPath
from service.planning.poses import SweepDesign, grid, has_room, room
from service.planning.safety.envelope_check import Envelope, noise_way
from service.planning.safety.travel import order_poses


def build_analysis_plan(robot: Robot, request: AnalysisRequest, cell: Cell) -> AnalysisPlan:
    """The plan of an initial analysis; BadInput names the field that is impossible."""
    as_sweeps = grid_of(request)
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
    runs = _Runs(robot, request, envelope, home)
    for index in axes:
        chosen = spread_poses(robot, index, candidates, request.poses)
        for pose in chosen[order_poses(chosen, np.array(runs.path.here))]:
            runs.measure(index, pose)
    if not runs.path.sweeps:
        raise BadInput("poses", f"no pose can be measured; reason for the first: {runs.dropped[0].reason}")
    return AnalysisPlan(
        robot=robot.name,
        request=request,
        sweeps=tuple(runs.path.sweeps),
        dropped=tuple(runs.dropped),
        candidates=len(poses),
        measurable=len(candidates),
        duration=runs.path.duration,
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


class _Runs:
    """The runs in order. Each pose has all of its runs, or none."""

    def __init__(self, robot: Robot, request: AnalysisRequest, envelope: Envelope, home: Array) -> None:
        self._robot, self._request, self._envelope = robot, request, envelope
        self.path = SweepPath[PlannedNoise | PlannedSweep](robot, envelope, home, request.move_velocity)
        self.dropped: list[DroppedPose] = []
        lines = _stepped_lines() if request.excitation == "stepped_sine" else ((), ())
        self._lines = lines * request.repeats  # of each run in a pose; () for noise

    def measure(self, index: int, pose: Array) -> None:
        """All runs of an axis in a pose, forward and backward over the same travel; else the reason for none."""
        direction = 1 if room(self._envelope, pose[None], index, 1)[0] else -1
        start: list[float] = pose.tolist()
        try:
            with self.path.all_or_none():
                for lines in self._lines:
                    run, travel = self._run(index, tuple(start), direction, lines)
                    self.path.add(run, travel)
                    start[index] += travel
                    direction = -direction
        except (EnvelopeViolation, BadInput) as error:
            self.dropped.append(DroppedPose(pose=tuple(pose.tolist()), reason=str(error)))

    def _run(
        self, index: int, start: tuple[float, ...], direction: int, lines: tuple[float, ...]
    ) -> tuple[PlannedNoise | PlannedSweep, float]:
        """A run without legs, and its travel, rad (m)."""
        robot, joint, envelope = self._robot, self._robot.joints[index], self._envelope
        load = float(inertia_rows(robot.chain, index, np.array([start]))[0] @ robot.chain.inertial.ravel())
        travel = SweepDesign.travel_share * envelope.limits.travel
        if not lines:
            inertia = load + (robot.axes[index].reflected_motor_inertia or 0.0)
            number = len(self.path.sweeps) + 1
            noise = design_noise(robot, joint, inertia=inertia, travel=travel, seed=number, direction=direction)
            return self._noise(index, start, noise), noise.travel
        design = design_sweep(
            robot,
            joint,
            np.array(start),
            load_inertia=load,
            lines=lines,
            direction=direction,
            travel=travel,
            velocity_limit=envelope.velocity_limit(index),
        )
        # a quarter of the normal amplitudes: at frequencies where the motor hardly moves, the load does
        smaller = tuple(sine.model_copy(update={"amplitude": 0.25 * sine.amplitude}) for sine in design.sines)
        spec = self._spec(index, start, design, SweepPurpose.STEPPED_SINE.value).model_copy(update={"sines": smaller})
        return self.path.of_sines(spec, SweepMode.DRIVE_SIDE, design, design.travel), design.travel

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
        return planned.model_copy(update={"position_window": self.path.window(start[index], design.travel, sway)})

    def _spec(
        self, index: int, start: tuple[float, ...], design: NoiseExcitation | Excitation, block: str
    ) -> SweepSpec:
        towards = "forward" if design.offset_velocity > 0 else "backward"
        return SweepSpec(
            id="0000",  # the path numbers it
            axis=self._robot.joints[index],
            pose=start,
            offset_velocity=design.offset_velocity,
            period=design.period,
            periods=design.periods,
            measure_from=design.measure_from,
            sample_rate=self._request.sample_rate,
            block=f"{block}_{towards}",
        )


def _stepped_lines() -> tuple[tuple[float, ...], ...]:
    """Lines of the sweeps of a stepped sine, Hz: together every integer frequency from 1 to 16."""
    return tuple(tuple(float(line) for line in range(first, 17, 4)) for first in range(1, 5))
