"""Live events (server-sent events): campaigns, sweeps, estimates, diagnoses, stops. Their ids only increase.

After a lost connection a client continues after the last id that it received (`Last-Event-ID`; browsers send it
automatically). An idle stream sends a comment every 15 s.
"""

import re
from collections.abc import AsyncIterable
from contextlib import aclosing
from typing import Annotated

from fastapi import APIRouter, Depends, Header, Query
from fastapi.sse import EventSourceResponse, ServerSentEvent
from starlette.concurrency import run_in_threadpool

from service.model.errors import BadInput
from service.store.documents import LARGEST_ID, EventKind
from service.web.api.dependencies import ApplicationOf

router = APIRouter(prefix="/events", tags=["events"])


def _after(
    after: Annotated[
        int | None, Query(ge=0, le=LARGEST_ID, description="events with a larger id; default: only new ones")
    ] = None,
    last_event_id: Annotated[str | None, Header(description="same as `after`; overrides it")] = None,
) -> int | None:
    if last_event_id is None:
        return after
    if re.fullmatch(r"[0-9]{1,10}", last_event_id) is None or int(last_event_id) > LARGEST_ID:
        raise BadInput("header/Last-Event-ID", f"{last_event_id!r} is not the id of an event")
    return int(last_event_id)


# a dependency: an exception of the generator comes after the start of the response
@router.get("", response_class=EventSourceResponse)
async def follow_events(
    application: ApplicationOf,
    after: Annotated[int | None, Depends(_after)],
    campaign: Annotated[int | None, Query(ge=1, le=LARGEST_ID, description="only events of this campaign")] = None,
) -> AsyncIterable[ServerSentEvent]:
    """`event`: the kind; `data`: the event document; `id`: its id.

    The data of a stop, and of its release, also have the present `epoch` (header `Sweepid-Epoch`).
    """
    start = await run_in_threadpool(application.store.last_event_id) if after is None else after
    yield ServerSentEvent(comment="connected", retry=1000)
    async with aclosing(application.feed.follow(start, campaign)) as events:
        async for event in events:
            if event.kind is EventKind.STOP and application.cell is not None:
                event = event.model_copy(update={"data": event.data | {"epoch": application.machine.epochs.now}})
            yield ServerSentEvent(data=event, event=event.kind.value, id=str(event.id))
