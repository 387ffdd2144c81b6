"""Whether the process runs, and whether it can measure now."""

import asyncio
from datetime import datetime

from fastapi import APIRouter, Response
from pydantic import BaseModel

from service.web.api.dependencies import ApplicationOf
from service.web.api.route_roles import allow
from service.web.application import Application

health_routes = APIRouter(prefix="/health", tags=["health"])


class Live(BaseModel):
    """The process answers."""

    alive: bool


class WaitingRecordings(BaseModel):
    """Recordings that the object store does not have yet: number, time of the oldest, and the error of the store."""

    waiting: int
    since: datetime | None
    trouble: str


class Ready(BaseModel):
    """`causes`: why measuring or identification is impossible now, one line per cause.

    A service without a machine is ready while it can show the plant.
    `recordings`: null if they stay in the data folder. An unreachable store is no cause: measuring continues.
    """

    ready: bool
    causes: tuple[str, ...]
    recordings: WaitingRecordings | None


@health_routes.head("/live", include_in_schema=False)  # monitors ask so
@health_routes.get("/live")
@allow(None)
async def get_live() -> Live:
    return Live(alive=True)


@health_routes.head("/ready", include_in_schema=False)
@health_routes.get("/ready", responses={503: {"model": Ready, "description": "not ready to measure"}})
@allow(None)
async def get_ready(response: Response, application: ApplicationOf) -> Ready:
    causes = await application.troubles()
    response.status_code = 503 if causes else 200
    return Ready(ready=not causes, causes=causes, recordings=await _recordings(application))


async def _recordings(application: Application) -> WaitingRecordings | None:
    moving = None if application.cell is None else application.cell.moving
    if moving is None:
        return None
    found = await asyncio.to_thread(moving.backlog)
    return WaitingRecordings.model_validate(found, from_attributes=True)
