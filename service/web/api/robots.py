"""Robots: description and URDF. A robot never changes; a corrected one is another robot with the same name."""

from datetime import datetime

from fastapi import APIRouter
from pydantic import BaseModel, ConfigDict, Field

from service.model.robot import RobotDescription, robot_from_outside
from service.store.documents import RobotDocument
from service.web.api.dependencies import After, ApplicationOf, Id, Limit, Page, page
from service.web.api.idempotent import IdempotentRoute

router = APIRouter(prefix="/robots", tags=["robots"], route_class=IdempotentRoute)


class NewRobot(BaseModel):
    """`description`: as the "robot" object of a bundle (its `urdf` is a file name). `urdf_text`: the URDF itself."""

    model_config = ConfigDict(extra="forbid")
    description: RobotDescription
    urdf_text: str = Field(min_length=1)


class RobotEntry(BaseModel):
    """A robot in the list."""

    id: int
    name: str
    joints: tuple[str, ...]
    created_at: datetime


@router.post("", status_code=201)
def add_robot(robot: NewRobot, application: ApplicationOf) -> RobotDocument:
    """Store a robot. The same description and URDF give the same robot."""
    return application.store.add_robot(robot_from_outside(robot.description, robot.urdf_text))


@router.get("")
def list_robots(application: ApplicationOf, after: After = 0, limit: Limit = 50) -> Page[RobotEntry]:
    robots = application.store.robots(after, limit)
    entries = tuple(
        RobotEntry(
            id=robot.id,
            name=robot.name,
            joints=tuple(axis.joint for axis in robot.description.axes),
            created_at=robot.created_at,
        )
        for robot in robots
    )
    return page(entries, limit)


@router.get("/{robot_id}")
def get_robot(robot_id: Id, application: ApplicationOf) -> RobotDocument:
    return application.store.robot(robot_id)
