"""Events as they happen (server-sent events): campaigns, sweeps, estimates, diagnoses, stops. Their ids only grow.

A client that lost the connection goes on after the last id it saw (`Last-Event-ID`, sent by browsers on their own); an
idle stream carries a comment every 15 s.
"""

import re
from collections.abc import AsyncIterable
from contextlib import aclosing
from typing import Annotated

from fastapi import APIRouter, Depends, Header, Query
from fastapi.sse import EventSourceResponse, ServerSentEvent
from starlette.concurrency import run_in_threadpool

from service.api.dependencies import ApplicationOf
from service.errors import BadInput
from service.store.documents import LARGEST_ID

router = APIRouter(prefix="/events", tags=["events"])


def _after(
    after: Annotated[
        int | None, Query(ge=0, le=LARGEST_ID, description="events with a larger id; default: only new ones")
    ] = None,
    last_event_id: Annotated[str | None, Header(description="as `after`, and stronger")] = None,
) -> int | None:
    if last_event_id is None:
        return after
    if re.fullmatch(r"[0-9]{1,10}", last_event_id) is None or int(last_event_id) > LARGEST_ID:
        raise BadInput("header/Last-Event-ID", f"{last_event_id!r} is not the id of an event")
    return int(last_event_id)


# a dependency, because what the generator raises comes after the response has begun
@router.get("", response_class=EventSourceResponse)
async def follow_events(
    application: ApplicationOf,
    after: Annotated[int | None, Depends(_after)],
    campaign: Annotated[int | None, Query(ge=1, le=LARGEST_ID, description="only events of this campaign")] = None,
) -> AsyncIterable[ServerSentEvent]:
    """`event` is the kind, `data` the event document, `id` its id."""
    start = await run_in_threadpool(application.store.last_event_id) if after is None else after
    yield ServerSentEvent(comment="connected", retry=1000)
    async with aclosing(application.feed.follow(start, campaign)) as events:
        async for event in events:
            yield ServerSentEvent(data=event, event=event.kind.value, id=str(event.id))
