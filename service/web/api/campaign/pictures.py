"""Pictures of a plan before the machine moves: the arm in its cell, leg by leg, and the poses of the grid."""

from typing import Annotated, Literal

import numpy as np
from fastapi import APIRouter, Query
from pydantic import BaseModel, ConfigDict

from service.model.errors import Conflict, NotFound
from service.model.geometry.cell import read_cell
from service.model.geometry.outline import Outline, Outlines
from service.planning.compiled_plan import plan_of
from service.planning.documents import PlanDocument
from service.planning.pose_choice import grid, has_room
from service.planning.safety.envelope import Envelope
from service.web.api.dependencies import ApplicationOf, Id

router = APIRouter(tags=["plans"])

LARGEST_SHOWN = 4000  # poses of a grid in one answer; of a larger grid every second, third ... pose is given
Corners = tuple[tuple[float, float], ...]


class OutlineView(BaseModel):
    """Outline of a link or of a box of the cell. Corners in m: (x, z) from the side, (x, y) from above."""

    model_config = ConfigDict(from_attributes=True)
    name: str
    side: Corners
    above: Corners


class Picture(BaseModel):
    """The arm in its cell after `step` of the `steps` legs that lead to the pose of a sweep.

    `pose`: rad (m), in the order of `joints`. `moves`: the joint that moves in this leg; empty at step 0.
    `floor`: height of the floor, m; null if the cell has none.
    """

    sweep: int
    step: int
    steps: int
    joints: tuple[str, ...]
    pose: tuple[float, ...]
    moves: str
    robot: tuple[OutlineView, ...]
    cell: tuple[OutlineView, ...]
    floor: float | None


class GridPose(BaseModel):
    """`at`: positions of the varied joints, rad (m). `state`: "chosen", the plan has sweeps in this pose; "free", it
    could be measured; "no_room", an axis has no room for its sweep; "collides", robot or cell would collide."""

    at: tuple[float, ...]
    state: Literal["chosen", "free", "no_room", "collides"]


class PoseGrid(BaseModel):
    """The poses from which a plan was chosen. `total`: poses of the grid; `poses` may contain every n-th one only."""

    varied: tuple[str, ...]
    total: int
    poses: tuple[GridPose, ...]


class Cells(BaseModel):
    """Names of the cells for which a plan can be made."""

    names: tuple[str, ...]


@router.get("/cells")
def list_cells(application: ApplicationOf) -> Cells:
    return Cells(names=tuple(sorted(file.stem for file in application.settings.cells_dir.glob("*.yaml"))))


@router.get("/plans/{plan_id}/picture")
def get_picture(
    plan_id: Id,
    application: ApplicationOf,
    sweep: Annotated[int, Query(ge=1, le=100_000, description="number of the sweep, from 1")] = 1,
    step: Annotated[int | None, Query(ge=0, le=10_000, description="legs done; default: all, the sweep's pose")] = None,
) -> Picture:
    """The picture is computed for each request. Nothing moves."""
    record = application.store.plan(plan_id)
    plan, robot = plan_of(record), application.store.robot(record.robot_id).build()
    if sweep > len(plan.sweeps):
        raise NotFound(f"sweep {sweep} does not exist; plan {plan_id} has {len(plan.sweeps)} sweeps")
    wanted = plan.sweeps[sweep - 1]
    steps = len(wanted.legs)
    done = steps if step is None else step
    if done > steps:
        raise NotFound(f"leg {done} does not exist; sweep {sweep} of plan {plan_id} is reached in {steps} legs")
    cell = read_cell(application.settings.cells_dir / f"{plan.request.cell}.yaml")
    pose = list(cell.home_pose(robot.joints) if sweep == 1 else plan.sweeps[sweep - 2].spec.pose)
    for leg in wanted.legs[:done]:
        pose[robot.index(leg.joint)] = leg.target
    if done == steps:
        pose = list(wanted.spec.pose)
    outlines = Outlines(robot, cell)
    return Picture(
        sweep=sweep,
        step=done,
        steps=steps,
        joints=robot.joints,
        pose=tuple(pose),
        moves=wanted.legs[done - 1].joint if done else "",
        robot=_views(outlines.of_robot(pose)),
        cell=_views(outlines.of_cell()),
        floor=cell.floor,
    )


@router.get("/plans/{plan_id}/grid")
def get_grid(plan_id: Id, application: ApplicationOf) -> PoseGrid:
    """409 for a plan that was not chosen from a grid (experiments, trajectories)."""
    record = application.store.plan(plan_id)
    plan, robot = plan_of(record), application.store.robot(record.robot_id).build()
    if not isinstance(plan, PlanDocument):
        raise Conflict(f"plan {plan_id} was not chosen from a grid of poses")
    cell = read_cell(application.settings.cells_dir / f"{plan.request.cell}.yaml")
    envelope = Envelope(robot, cell)
    poses = grid(robot, plan.request, envelope, np.array(cell.home_pose(robot.joints)))
    measured = np.array([one.spec.pose for one in plan.sweeps])
    chosen = (np.abs(poses[:, None, :] - measured[None, :, :]).max(axis=2) < 1e-6).any(axis=1)
    shown = chosen | (np.arange(len(poses)) % -(-len(poses) // LARGEST_SHOWN) == 0)
    poses, chosen = poses[shown], chosen[shown]
    free = envelope.checker.collision_free(poses)
    room = np.zeros(len(poses), dtype=bool)
    room[free] = has_room(envelope, poses[free], [robot.index(joint) for joint in plan.request.axes])
    varied = [robot.index(joint) for joint in plan.request.varied]
    rows = zip(poses[:, varied].tolist(), chosen.tolist(), free.tolist(), room.tolist(), strict=True)
    return PoseGrid(
        varied=plan.request.varied,
        total=len(shown),
        poses=tuple(GridPose(at=tuple(at), state=_state(*kinds)) for at, *kinds in rows),
    )


def _state(chosen: bool, free: bool, room: bool) -> Literal["chosen", "free", "no_room", "collides"]:
    if chosen:
        return "chosen"
    return "collides" if not free else "free" if room else "no_room"


def _views(outlines: tuple[Outline, ...]) -> tuple[OutlineView, ...]:
    return tuple(OutlineView.model_validate(one) for one in outlines)
