"""The stop: accepted always and from all callers. Afterwards a person must release each stop before motion.

This is the answer of the service itself. `service.machine.stop_process` listens in parallel if the service is too busy.
"""

from http import HTTPStatus
from typing import Annotated, Any

from fastapi import APIRouter, Query, Request, Response
from pydantic import BaseModel, BeforeValidator, ConfigDict, Field

from drivers.errors import StopNotConfirmed
from service.machine.execution.statement import NO_MACHINE
from service.machine.stop_process.listener import LONGEST_WAIT, not_confirmed, waiting_time
from service.store.access import PersonName, Role, masked
from service.store.documents import LARGEST_ID, StopDocument
from service.store.table_rows import NoMachine
from service.web.api.access import audit_trail_of
from service.web.api.dependencies import ApplicationOf
from service.web.api.drives import StatementView
from service.web.api.problem import Problem, problem_response
from service.web.api.route_roles import allow
from service.web.application import Application

router = APIRouter(prefix="/stop", tags=["stop"])

_SHOWN = 100  # stops in one answer
_UNCONFIRMED = Problem(
    type="urn:sweepid:problem:stop-not-confirmed",
    title="Service Unavailable",
    status=503,
    detail="stop sent, not confirmed within 1 s: joint_2: node 2 does not answer; use the emergency stop",
    instance="/api/v1/stop",
    sent=("joint_1", "joint_2"),
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


class StopView(BaseModel):
    """Whether the machine is held (`latched`), and the stops that hold it (`stops`, the oldest 100).

    `stop`: the oldest one that holds it; after a stop the new one; after a release the first released one.
    A stop has a negative id until the database has stored it. This id stays valid for the release. `port`: where the
    stop process listens for ``POST /stop``, null without a stop process. `process_trouble`: why its own connection to
    the drives is not open, or that it hangs. `epoch`: a stop begins a new one, a release does not (header
    `Sweepid-Epoch`). `statement`: the state of the machine.
    """

    latched: bool
    epoch: str
    stop: StopDocument | None
    stops: tuple[StopDocument, ...]
    port: int | None
    process_trouble: str
    statement: StatementView


class Stopped(StopView):
    """`sent`: the axes to which the stop was sent. `confirmed`: those that report standstill without energy.

    200: all of them; 202, only with `wait=0`: none yet; otherwise 503, with the reason by axis in `unconfirmed`.
    """

    sent: tuple[str, ...]
    confirmed: tuple[str, ...]
    unconfirmed: dict[str, str]


class Reset(BaseModel):
    """`by`: the person who checked the machine. `stops`: ids of the stops to release."""

    model_config = ConfigDict(extra="forbid")
    by: PersonName
    stops: Annotated[
        tuple[Annotated[int, Field(ge=-LARGEST_ID, le=LARGEST_ID)], ...], Field(min_length=1, max_length=_SHOWN)
    ]


@router.get("")
@allow(None)
async def get_stop(application: ApplicationOf) -> StopView:
    if application.cell is not None:
        await application.machine.ask()
    return _view(application, None if application.cell is None else application.machine.latched)


@router.post("", response_model=Stopped, responses=_NOT_CONFIRMED)
@allow(None)
async def stop(
    request: Request,
    response: Response,
    application: ApplicationOf,
    by: Annotated[str, Query(description="who stops; default: the client's address")] = "",
    why: Annotated[str, Query()] = "",
    press: Annotated[
        str, Query(description="same value as at the port of the stop process: both requests are then one stop")
    ] = "",
    wait: Annotated[
        float,
        BeforeValidator(waiting_time),  # a stop is not refused for a bad value
        Query(ge=0, le=LONGEST_WAIT, description="s to wait for the confirmation; 0: answer 202 as soon as it is sent"),
    ] = LONGEST_WAIT,
) -> Stopped | Response:
    """Stop every axis now and hold the machine. A body is not required and is not read.

    Sent is not stopped: 503, after at most 1 s, lists the axes that did not confirm standstill; the machine is held and
    the stop sequence goes on in this case too. A service without a machine stops nothing and answers 503
    (`no-machine`).
    """
    nothing_stopped = (
        "nothing was stopped: this service has no machine (`--no-machine`); press STOP on the page of the machine's "
        "own service, or the emergency stop at the machine"
    )
    client = "unknown" if request.client is None else request.client.host
    by, why = by[:100] or client, why[:500] or "stop requested"
    audit_trail_of(request.scope).facts = {"by": masked(by), "reason": masked(why)}
    if application.cell is None:
        # no database query for its machines: a stop must not wait
        return problem_response(request, HTTPStatus.SERVICE_UNAVAILABLE, "no-machine", nothing_stopped)
    machine = application.machine
    sent = machine.joints if machine.connected else ()
    try:
        held = await machine.stop(by, why, press[:100], f"{client} {by}", wait)
    except StopNotConfirmed as error:
        if not wait and sent:
            response.status_code = HTTPStatus.ACCEPTED
            held = next(iter(reversed(machine.stops)), None)
            return Stopped(**_view(application, held).model_dump(), sent=sent, confirmed=(), unconfirmed={})
        return problem_response(
            request,
            HTTPStatus.SERVICE_UNAVAILABLE,
            "stop-not-confirmed",
            not_confirmed(bool(sent), wait, error.unconfirmed),
            additional={"sent": sent, "confirmed": error.confirmed, "unconfirmed": error.unconfirmed},
        )
    view = _view(application, held).model_dump()
    return Stopped(**view, sent=machine.joints, confirmed=machine.joints, unconfirmed={})


@router.post(
    "/reset",
    responses={503: {"model": Problem, "description": "not released: the database or the audit cannot be written"}},
)
@allow(Role.OPERATOR)
async def reset_stop(request: Request, reset: Reset, application: ApplicationOf) -> StopView:
    """Release these stops and no others. A repeated request changes nothing. Motion is possible when no stop is left.

    Nothing moves by this request; a campaign continues after its resume. 503 with `Retry-After` if the database does
    not store the release within some seconds: then all stops stay active.
    """
    audit_trail_of(request.scope).facts = {"by": reset.by, "stops": list(reset.stops)}
    released = await application.machine.reset_stop(reset.by, reset.stops)
    return _view(application, released[0])


def _view(application: Application, spoken_of: StopDocument | None) -> StopView:
    if application.cell is None:
        trouble, statement = str(NoMachine()), StatementView.of(NO_MACHINE)
        return StopView(
            latched=False, epoch="", stop=None, stops=(), port=None, process_trouble=trouble, statement=statement
        )
    process, stops = application.cell.stop_process, application.machine.stops
    return StopView(
        latched=bool(stops),
        epoch=application.machine.epochs.now,
        stop=spoken_of,
        stops=stops[:_SHOWN],
        port=None if process is None else process.port,
        process_trouble="no stop process" if process is None else process.trouble,
        statement=StatementView.of(application.machine.statement),
    )
