"""Import and export of bundles: a zip of the folder that the BUNDLE format `sweepid-bundle/1` describes."""

import hashlib
import shutil
import tempfile
from pathlib import Path
from typing import Any

from fastapi import APIRouter, Request, Response
from fastapi.responses import FileResponse
from starlette.background import BackgroundTask
from starlette.concurrency import run_in_threadpool

from service.process.tasks import run_to_end
from service.store.access import Role
from service.store.files.bundle import pack
from service.web.api.campaigns import CampaignView, view
from service.web.api.dependencies import ApplicationOf, Handler, Id, IdempotentRoute, head_of, media, set_etag
from service.web.api.route_roles import allow


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
            if len(piece) >= 2**20:  # bytes per write
                await run_in_threadpool(write)
        await run_in_threadpool(write)


router = APIRouter(tags=["bundles"], route_class=SpooledRoute)
BUNDLES = "/bundles"
_BODY: dict[str, Any] = {
    # an octet stream is a zip as well: what generated clients of Python know
    "requestBody": {"required": True, **media("application/zip", "application/octet-stream")[200]}
}


@router.post(BUNDLES, status_code=201, openapi_extra=_BODY)
@allow(Role.ENGINEER)
async def import_bundle(request: Request, response: Response, application: ApplicationOf) -> CampaignView:
    """Import a campaign of measured sweeps; they are then identified. A bundle with an unreadable part is refused."""
    campaign = await application.import_bundle(request.state.body)
    set_etag(response, campaign.version)
    response.headers["Location"] = str(request.url_for("get_campaign", campaign_id=campaign.id))
    return await run_in_threadpool(view, application, campaign)


@router.get("/campaigns/{campaign_id}/bundle", response_class=FileResponse, responses=media("application/zip"))
@allow(Role.VIEWER)
async def export_bundle(campaign_id: Id, application: ApplicationOf) -> FileResponse:
    """A bundle with the completely recorded sweeps of a campaign."""
    folder = Path(await run_in_threadpool(tempfile.mkdtemp, prefix="export-", dir=application.files.transfer()))
    try:
        await application.export_bundle(campaign_id, folder / "bundle")
        packed = await run_in_threadpool(pack, folder / "bundle", folder / "bundle.zip")
    except BaseException:
        await run_to_end(run_in_threadpool(shutil.rmtree, folder))
        raise
    return FileResponse(
        packed,
        media_type="application/zip",
        filename=f"campaign-{campaign_id}.zip",
        background=BackgroundTask(shutil.rmtree, folder),
    )
