"""Live samples of the running sweep: a WebSocket that sends one binary Arrow IPC stream per message.

Each message contains one record batch (time s, effort N m, velocity rad/s, position rad). The metadata of the schema
contain campaign, sweep and joint. With `?form=json` each message is text, for browsers: an object with the same
columns as lists, and `campaign`, `sweep` and `joint`. Samples are decimated, and a client that is too slow loses the
oldest ones; the recording contains all samples.
"""

import asyncio
import json
from functools import lru_cache
from typing import Any, Literal, cast

import pyarrow as pa
from fastapi import APIRouter, WebSocket, WebSocketDisconnect
from starlette.concurrency import run_in_threadpool

from service.model.errors import NotFound
from service.planning.campaigns.live import Array, LiveBlock
from service.web.api.dependencies import ApplicationOf, Id
from service.web.api.people.credentials import LIVE

router = APIRouter(prefix="/campaigns/{campaign_id}/live", tags=["live"])

# pyarrow has no type information
_arrow = cast(Any, pa)

_UNKNOWN_CAMPAIGN = 4404  # private close code: 4000 + the HTTP status
_BLOCKS = 16  # last ones, each encoded once for all viewers: a sweep's set-points wait meanwhile


@router.websocket("")
async def send_samples(
    socket: WebSocket, campaign_id: Id, application: ApplicationOf, form: Literal["arrow", "json"] = "arrow"
) -> None:
    named: list[str] = socket.scope.get("subprotocols", [])
    await socket.accept(LIVE if LIVE in named else None)
    try:
        await run_in_threadpool(application.store.campaign, campaign_id)
    except NotFound as error:
        await socket.close(_UNKNOWN_CAMPAIGN, str(error))
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


@lru_cache(_BLOCKS)
def text(block: LiveBlock) -> str:
    """One block as a JSON object; numbers have seven digits."""
    columns = {name: [float(f"{one:.7g}") for one in column] for name, column in _columns(block).items()}
    return json.dumps({"campaign": block.campaign_id, "sweep": block.number, "joint": block.joint} | columns)


def _columns(block: LiveBlock) -> dict[str, Array]:
    return {"time": block.time, "effort": block.effort, "velocity": block.velocity, "position": block.position}


@lru_cache(_BLOCKS)
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
