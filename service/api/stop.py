"""The stop: always accepted, from anybody. What moves afterwards waits for a person's reset."""

from typing import Annotated

from fastapi import APIRouter, Query, Request
from pydantic import BaseModel, ConfigDict, StringConstraints

from service.api.dependencies import LabOf
from service.store.documents import StopDocument

router = APIRouter(prefix="/stop", tags=["stop"])


class StopView(BaseModel):
    """Whether the machine is held, and the stop that was spoken of last."""

    latched: bool
    stop: StopDocument | None


class Reset(BaseModel):
    """Who looked at the machine."""

    model_config = ConfigDict(extra="forbid")
    by: Annotated[str, StringConstraints(strip_whitespace=True, min_length=1, max_length=100)]


@router.get("")
async def get_stop(lab: LabOf) -> StopView:
    held = lab.machine.latched
    return StopView(latched=held is not None, stop=held)


@router.post("")
async def stop(
    request: Request,
    lab: LabOf,
    by: Annotated[str, Query(description="who stops; default: the client's address")] = "",
    why: Annotated[str, Query()] = "",
) -> StopView:
    """Stop every axis now and hold the machine. No body is needed, none is waited for or read."""
    client = "unknown" if request.client is None else request.client.host
    held = await lab.machine.stop(by[:100] or client, why[:500] or "stop requested")
    return StopView(latched=True, stop=held)


@router.post("/reset")
async def reset_stop(reset: Reset, lab: LabOf) -> StopView:
    """Let the machine move again. Nothing moves by this; a campaign goes on when it is resumed."""
    return StopView(latched=False, stop=await lab.machine.reset_stop(reset.by))
