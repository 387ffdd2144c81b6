"""Plans exciting trajectories: several axes move along Fourier series within limits; the whole path is checked."""

import numpy as np

from drivers.ports import SweepMode
from service import BadInput, EnvelopeViolation
from service.identification.design.exciting_trajectory import (
    Trajectory,
    TrajectoryLimits,
    TrajectoryShape,
    design_trajectory,
)
from service.identification.model import dynamic_base, joint_ranges
from service.identification.payloads import planned_mass_std
from service.model import Array, Robot, SweepSpec, together
from service.model.configuration import Cell
from service.planning.documents import PlannedSweep, TrajectoryPlan, TrajectoryRequest
from service.planning.path import SweepPath
from service.planning.safety.envelope_check import Envelope


def build_trajectory_plan(robot: Robot, request: TrajectoryRequest, cell: Cell) -> TrajectoryPlan:
    """The plan of a request; BadInput names the field that is impossible."""
    for joint in request.axes:
        if joint not in robot.joints:
            raise BadInput("axes", f"unknown joint {joint}; robot {robot.name} has {', '.join(robot.joints)}")
    if len(set(request.axes)) < len(request.axes):
        raise BadInput("axes", f"names a joint twice: {', '.join(request.axes)}")
    envelope = Envelope(robot, cell)
    if request.velocity > envelope.limits.trajectory_velocity:
        raise BadInput("velocity", f"{request.velocity} is above the limit {envelope.limits.trajectory_velocity}")
    home = np.array(cell.home_pose(robot.joints))
    limits = _limits(robot, request, envelope, home)
    base = dynamic_base(robot, (limits.lower, limits.upper))
    shape = TrajectoryShape(request.period, request.harmonics, request.periods)
    path = SweepPath[PlannedSweep](robot, envelope, home, request.move_velocity)
    condition: list[float] = []
    payload_std: list[float] = []
    for number in range(1, request.trajectories + 1):
        run = design_trajectory(
            robot,
            base.columns,
            limits,
            shape,
            envelope.checker.path_free,
            seed=request.seed + number,
            restarts=20,  # shapes tried
            steps=40,  # to improve the best of them
        )
        if not np.isfinite(run.condition):
            raise BadInput(
                "harmonics",
                f"{request.harmonics} are too few to determine the {len(base.columns)} base parameters of the axes",
            )
        travels = (run.path(np.array([run.duration]))[0] - run.start)[[robot.index(joint) for joint in request.axes]]
        try:
            path.add_together(
                _sweeps(robot, request, envelope, run, together(number, len(request.axes))), travels.tolist()
            )
        except EnvelopeViolation as error:
            raise BadInput("seed", f"trajectory {number} of seed {request.seed} cannot be run: {error}") from None
        condition.append(run.condition)
        time = np.arange(0.0, run.duration, 1 / request.sample_rate)
        payload_std.append(planned_mass_std(robot, run.path(time), request.sample_rate))
    return TrajectoryPlan(
        robot=robot.name,
        request=request,
        sweeps=tuple(path.sweeps),
        condition=tuple(condition),
        payload_std=tuple(payload_std),
        duration=path.duration,
    )


def _limits(robot: Robot, request: TrajectoryRequest, envelope: Envelope, home: Array) -> TrajectoryLimits:
    """Limits of the moving axes; the others do not move."""
    own = envelope.limits
    lower, upper = joint_ranges(robot.chain)
    for index, joint in enumerate(robot.joints):
        if joint not in request.axes:
            lower[index] = upper[index] = home[index]
            continue
        low, high = envelope.joint_range(index)
        margin = own.trajectory_deviation + own.window_margin
        lower[index], upper[index] = max(lower[index], low) + margin, min(upper[index], high) - margin
    joints = robot.chain.joints
    return TrajectoryLimits(
        lower=lower,
        upper=upper,
        velocity=np.array([min(request.velocity, joint.velocity) for joint in joints]),
        acceleration=np.full(len(joints), request.acceleration),
        effort=0.9 * np.array([joint.effort for joint in joints]),
    )


def _sweeps(
    robot: Robot, request: TrajectoryRequest, envelope: Envelope, run: Trajectory, block: str
) -> list[PlannedSweep]:
    """The sweeps of the axes of a trajectory."""
    way = run.path(np.linspace(0.0, run.duration, 1000))
    margin = envelope.limits.trajectory_deviation
    sweeps: list[PlannedSweep] = []
    for joint in request.axes:
        index = robot.index(joint)
        design = run.excitations[index]
        sweeps.append(
            PlannedSweep(
                spec=SweepSpec(
                    id="0000",  # the path numbers it
                    axis=joint,
                    pose=tuple(run.start.tolist()),
                    offset_velocity=0.0,
                    excitation="trajectory",
                    sines=design.sines,
                    period=design.period,
                    periods=design.periods,
                    measure_from=design.measure_from,
                    sample_rate=request.sample_rate,
                    block=block,
                ),
                mode=SweepMode.HOST_STREAMED,
                ramp=design.ramp,
                settle=design.settle,
                velocity_limit=min(envelope.limits.trajectory_velocity, robot.chain.joints[index].velocity),
                effort_limit=envelope.effort_limit(index),
                position_window=(float(way[:, index].min()) - margin, float(way[:, index].max()) + margin),
                legs=(),
                duration=run.duration,
            )
        )
    return sweeps
