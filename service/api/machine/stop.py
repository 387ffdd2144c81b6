"""The stop: always accepted, from anybody. What moves afterwards waits for a person's release, stop by stop.

The service's own answer; `service.stop_process` listens beside it for when the service has no time.
"""

from http import HTTPStatus
from typing import Annotated, Any

from fastapi import APIRouter, Query, Request, Response
from pydantic import BaseModel, ConfigDict, Field, StringConstraints

from drivers.errors import StopNotConfirmed
from service.api.dependencies import ApplicationOf
from service.api.people.trail import trail_of
from service.api.problem import Problem, problem_response
from service.application import Application
from service.people.keys import masked
from service.store.documents import LARGEST_ID, StopDocument

router = APIRouter(prefix="/stop", tags=["stop"])

_SHOWN = 100  # stops in an answer
_UNCONFIRMED = Problem(
    type="urn:sweepid:problem:stop-not-confirmed",
    title="Service Unavailable",
    status=503,
    detail="stop not confirmed: joint_2: node 2 does not answer",
    instance="/api/v1/stop",
    confirmed=("joint_1",),
    unconfirmed={"joint_2": "node 2 does not answer"},
)
_NOT_CONFIRMED: dict[int | str, dict[str, Any]] = {
    503: {
        "model": Problem,
        "description": "latched, but axes did not confirm standstill: `unconfirmed`",
        "content": {"application/json": {"examples": {"answer": {"value": _UNCONFIRMED.model_dump(mode="json")}}}},
    }
}
_NOT_RELEASED: dict[int | str, dict[str, Any]] = {
    503: {"model": Problem, "description": "nothing released: the database or the audit does not take it"}
}


class StopView(BaseModel):
    """Whether the machine is held, the stop that was spoken of last, and the stops that hold it (the oldest 100).

    A stop has a negative id until the database has taken it, which stays good for its release. `port` is where the
    stop process listens for ``POST /stop``, null where there is none; `process_trouble` is why its own way to the
    drives is not open.
    """

    latched: bool
    stop: StopDocument | None
    stops: tuple[StopDocument, ...]
    port: int | None
    process_trouble: str


class Stopped(StopView):
    """`confirmed`: the axes that said that they stand without energy; all of them, or the answer is 503."""

    confirmed: tuple[str, ...]


class Reset(BaseModel):
    """Who looked at the machine, and which stops that releases."""

    model_config = ConfigDict(extra="forbid")
    by: Annotated[str, StringConstraints(strip_whitespace=True, min_length=1, max_length=100)]
    stops: Annotated[
        tuple[Annotated[int, Field(ge=-LARGEST_ID, le=LARGEST_ID)], ...], Field(min_length=1, max_length=_SHOWN)
    ]


@router.get("")
async def get_stop(application: ApplicationOf) -> StopView:
    return _view(application, application.machine.latched)


@router.post("", response_model=Stopped, responses=_NOT_CONFIRMED)
async def stop(
    request: Request,
    application: ApplicationOf,
    by: Annotated[str, Query(description="who stops; default: the client's address")] = "",
    why: Annotated[str, Query()] = "",
    press: Annotated[str, Query(description="the same at the port of the stop process: then both are one stop")] = "",
) -> Stopped | Response:
    """Stop every axis now and hold the machine. No body is needed, none is waited for or read.

    503 names the axes that did not confirm that they stand; the machine is held all the same.
    """
    client = "unknown" if request.client is None else request.client.host
    by, why = by[:100] or client, why[:500] or "stop requested"
    trail_of(request.scope).told = {"by": masked(by), "reason": masked(why)}
    try:
        held = await application.machine.stop(by, why, press[:100])
    except StopNotConfirmed as error:
        told = {"confirmed": error.confirmed, "unconfirmed": error.unconfirmed}
        return problem_response(
            request, HTTPStatus.SERVICE_UNAVAILABLE, "stop-not-confirmed", f"stop not confirmed: {error}", told=told
        )
    return Stopped(**_view(application, held).model_dump(), confirmed=application.machine.joints)


@router.post("/reset", responses=_NOT_RELEASED)
async def reset_stop(request: Request, reset: Reset, application: ApplicationOf) -> StopView:
    """Release these stops and no other; sent again it changes nothing. The machine may move when none is left.

    Nothing moves by this; a campaign goes on when it is resumed. 503 with `Retry-After` where the database does not
    take it within some seconds: every stop holds on.
    """
    trail_of(request.scope).told = {"by": masked(reset.by), "stops": list(reset.stops)}
    released = await application.machine.reset_stop(reset.by, reset.stops)
    return _view(application, released[0])


def _view(application: Application, spoken_of: StopDocument | None) -> StopView:
    process, stops = application.stop_process, application.machine.stops
    return StopView(
        latched=bool(stops),
        stop=spoken_of,
        stops=stops[:_SHOWN],
        port=None if process is None else process.port,
        process_trouble="no stop process" if process is None else process.trouble,
    )
