"""Is the process alive, and could it measure now?"""

from fastapi import APIRouter, Response
from pydantic import BaseModel

from service.api.dependencies import LabOf

router = APIRouter(prefix="/health", tags=["health"])


class Live(BaseModel):
    alive: bool


class Ready(BaseModel):
    """`causes` says why nothing can be measured now, one line each."""

    ready: bool
    causes: tuple[str, ...]


@router.get("/live")
async def get_live() -> Live:
    return Live(alive=True)


@router.get("/ready", responses={503: {"model": Ready, "description": "nothing can be measured now"}})
async def get_ready(response: Response, lab: LabOf) -> Ready:
    causes: list[str] = []
    if not lab.machine.connected:
        causes.append(f"machine not connected: {lab.machine.trouble or 'not tried yet'}")
    if lab.machine.forbidden:
        causes.append(lab.machine.forbidden)
    process = lab.stop_process
    if process is not None and process.ended:
        causes.append(process.trouble)
    response.status_code = 503 if causes else 200
    return Ready(ready=not causes, causes=tuple(causes))
