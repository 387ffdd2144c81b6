"""Is the process alive, and could it measure now?"""

from fastapi import APIRouter, Response
from pydantic import BaseModel

from service.api.dependencies import ApplicationOf

router = APIRouter(prefix="/health", tags=["health"])


class Live(BaseModel):
    """The process answers."""

    alive: bool


class Ready(BaseModel):
    """`causes` says why nothing can be measured now, or is not identified, one line each."""

    ready: bool
    causes: tuple[str, ...]


@router.get("/live")
async def get_live() -> Live:
    return Live(alive=True)


@router.get("/ready", responses={503: {"model": Ready, "description": "nothing can be measured now"}})
async def get_ready(response: Response, application: ApplicationOf) -> Ready:
    causes = await application.troubles()
    response.status_code = 503 if causes else 200
    return Ready(ready=not causes, causes=causes)
