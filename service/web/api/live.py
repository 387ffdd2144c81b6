"""Live events (server-sent events): campaigns, sweeps, estimates, diagnoses, stops. Their ids only increase.

After a lost connection a client continues after the last id that it received (`Last-Event-ID`; browsers send it
automatically). An idle stream sends a comment every 15 s.
"""

import asyncio
import json
import re
from collections.abc import AsyncIterable
from contextlib import aclosing
from functools import lru_cache
from typing import Annotated, Any, Literal, cast

import pyarrow as pa
from fastapi import APIRouter, Depends, Header, Query, WebSocket, WebSocketDisconnect
from fastapi.sse import EventSourceResponse, ServerSentEvent
from starlette.concurrency import run_in_threadpool

from service import BadInput, NotFound
from service.planning.campaigns.live import Array, LiveBlock
from service.store.access import Role
from service.store.documents import LARGEST_ID, EventKind
from service.web.api.access import LIVE
from service.web.api.dependencies import ApplicationOf, Id
from service.web.api.route_roles import allow

event_routes = APIRouter(prefix="/events", tags=["events"])
live_routes = APIRouter(prefix="/campaigns/{campaign_id}/live", tags=["live"])


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
@event_routes.get("", response_class=EventSourceResponse)
@allow(Role.VIEWER)
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


# pyarrow has no type information
_arrow = cast(Any, pa)


@live_routes.websocket("")
@allow(Role.VIEWER)
async def send_samples(
    socket: WebSocket, campaign_id: Id, application: ApplicationOf, form: Literal["arrow", "json"] = "arrow"
) -> None:
    named: list[str] = socket.scope.get("subprotocols", [])
    await socket.accept(LIVE if LIVE in named else None)
    try:
        await run_in_threadpool(application.store.campaign, campaign_id)
    except NotFound as error:
        await socket.close(4404, str(error))  # private close code: 4000 + the HTTP status
        return
    sender = asyncio.create_task(
        _send(socket, campaign_id, application, form == "json"), name=f"live samples of campaign {campaign_id}"
    )
    listener = asyncio.create_task(_until_disconnect(socket), name="live listener")
    try:
        await asyncio.wait({sender, listener}, return_when=asyncio.FIRST_COMPLETED)
    finally:
        for task in (sender, listener):
            task.cancel()
        results = await asyncio.gather(sender, listener, return_exceptions=True)
    for result in results:
        if isinstance(result, Exception) and not isinstance(result, WebSocketDisconnect):
            raise result
    if not isinstance(results[0], BaseException):  # the hub was closed: the service shuts down
        await socket.close(1001, "the service ends")


async def _send(socket: WebSocket, campaign_id: int, application: ApplicationOf, as_text: bool) -> None:
    with application.hub.subscribe(campaign_id) as queue:
        async for block in queue:
            if as_text:
                await socket.send_text(text(block))
            else:
                await socket.send_bytes(message(block))


@lru_cache(16)  # each block is encoded once for all viewers: a sweep's set-points wait meanwhile
def text(block: LiveBlock) -> str:
    """One block as a JSON object; numbers have seven digits."""
    columns = {name: [float(f"{one:.7g}") for one in column] for name, column in _columns(block).items()}
    return json.dumps({"campaign": block.campaign_id, "sweep": block.number, "joint": block.joint} | columns)


def _columns(block: LiveBlock) -> dict[str, Array]:
    return {"time": block.time, "effort": block.effort, "velocity": block.velocity, "position": block.position}


@lru_cache(16)
def message(block: LiveBlock) -> bytes:
    """One block as an Arrow stream."""
    columns = _columns(block)
    batch = _arrow.RecordBatch.from_pydict(columns).replace_schema_metadata(
        {"campaign": str(block.campaign_id), "sweep": str(block.number), "joint": block.joint}
    )
    sink = _arrow.BufferOutputStream()
    with _arrow.ipc.new_stream(sink, batch.schema) as writer:
        writer.write_batch(batch)
    return cast(bytes, sink.getvalue().to_pybytes())


async def _until_disconnect(socket: WebSocket) -> None:
    while (await socket.receive())["type"] != "websocket.disconnect":
        pass
