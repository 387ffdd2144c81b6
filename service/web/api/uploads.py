"""Large bodies are written to a file while they arrive: the process of the machine never holds one in memory."""

import hashlib
import shutil
import tempfile
from pathlib import Path

from fastapi import Request, Response
from starlette.concurrency import run_in_threadpool

from service.process.tasks import run_to_end
from service.web.api.idempotent import Handler, IdempotentRoute, head_of

_PIECE = 2**20  # bytes per write


class SpooledRoute(IdempotentRoute):
    """A route that writes the body of a POST request to the file `request.state.body`, and deletes it afterwards."""

    def get_route_handler(self) -> Handler:
        handle = super().get_route_handler()

        async def handle_spooled(request: Request) -> Response:
            if request.method != "POST":
                return await handle(request)
            parent: Path = request.app.state.application.files.transfer()
            folder = Path(await run_in_threadpool(tempfile.mkdtemp, prefix="import-", dir=parent))
            try:
                request.state.body = folder / "body"
                await _spool(request, request.state.body)
                return await handle(request)
            finally:
                await run_to_end(run_in_threadpool(shutil.rmtree, folder))

        return handle_spooled


async def _spool(request: Request, path: Path) -> None:
    """Write the body, and store the fingerprint of the request: the body cannot be read twice."""
    request.state.fingerprint = found = hashlib.sha256(head_of(request))
    piece = bytearray()
    with path.open("wb") as file:

        def write() -> None:
            file.write(piece)
            found.update(piece)
            piece.clear()

        async for part in request.stream():
            piece += part
            if len(piece) >= _PIECE:
                await run_in_threadpool(write)
        await run_in_threadpool(write)
