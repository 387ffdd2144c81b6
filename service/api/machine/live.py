"""Samples of the running sweep as they come: a WebSocket that sends one binary Arrow IPC stream a message.

Each message holds one record batch (time s, effort N m, velocity rad/s, position rad); campaign, sweep and joint
stand in the schema's metadata. Samples are thinned, and a client that is too slow loses the oldest: the recording has
them all.
"""

import asyncio
from typing import Any, cast

import pyarrow as pa
from fastapi import APIRouter, WebSocket, WebSocketDisconnect
from starlette.concurrency import run_in_threadpool

from service.api.dependencies import ApplicationOf, Id
from service.campaigns.live import LiveBlock
from service.errors import NotFound

router = APIRouter(prefix="/campaigns/{campaign_id}/live", tags=["live"])

# pyarrow ships without types
_arrow = cast(Any, pa)

_UNKNOWN_CAMPAIGN = 4404  # close code of our own: 4000 + the HTTP status


@router.websocket("")
async def send_samples(socket: WebSocket, campaign_id: Id, application: ApplicationOf) -> None:
    await socket.accept()
    try:
        await run_in_threadpool(application.store.campaign, campaign_id)
    except NotFound as error:
        await socket.close(_UNKNOWN_CAMPAIGN, str(error))
        return
    sender = asyncio.create_task(
        _send(socket, campaign_id, application), name=f"live samples of campaign {campaign_id}"
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
    if not isinstance(results[0], BaseException):  # the hub was closed: the service ends
        await socket.close(1001, "the service ends")


async def _send(socket: WebSocket, campaign_id: int, application: ApplicationOf) -> None:
    with application.hub.subscribe(campaign_id) as queue:
        async for block in queue:
            await socket.send_bytes(message(block))


def message(block: LiveBlock) -> bytes:
    """The Arrow stream of one block."""
    columns = {"time": block.time, "effort": block.effort, "velocity": block.velocity, "position": block.position}
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
