"""Bundles in and out, as a zip of the folder that BUNDLE format `sweepid-bundle/1` describes."""

import asyncio
import errno
import io
import lzma
import shutil
import tempfile
import zipfile
import zlib
from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path as FilePath
from typing import Any

from fastapi import APIRouter, Request, Response
from fastapi.responses import FileResponse
from starlette.background import BackgroundTask
from starlette.concurrency import run_in_threadpool

from service.api.campaigns import CampaignView, view
from service.api.dependencies import Id, LabOf, set_etag
from service.api.idempotent import IdempotentRoute
from service.errors import BadInput

router = APIRouter(tags=["bundles"], route_class=IdempotentRoute)

BUNDLES = "/bundles"
_ZIP = "application/zip"
_MAX_UNPACKED = 4 * 2**30  # bytes; a small zip can hold a very large file
# a name too long, a file that is a folder as well; None: bad bzip2 data. Others, as a full disk, are our own trouble
_BAD_MEMBER = (errno.ENAMETOOLONG, errno.ENOTDIR, errno.EISDIR, errno.EEXIST, None)
_BODY: dict[str, Any] = {
    "requestBody": {"required": True, "content": {_ZIP: {"schema": {"type": "string", "format": "binary"}}}}
}


@router.post(BUNDLES, status_code=201, openapi_extra=_BODY)
async def import_bundle(request: Request, response: Response, lab: LabOf) -> CampaignView:
    """A campaign of measured sweeps, which are then identified. What cannot be read is refused as a whole."""
    content = await request.body()
    with _temporary_folder(lab.files.transfer()) as folder:
        await run_in_threadpool(_unpack, content, folder)
        try:
            campaign = await lab.import_bundle(folder)
        except BadInput as error:  # the client knows its bundle, not our folder
            raise BadInput(_own_place(error.place, folder), _own_place(error.reason, folder)) from None
    set_etag(response, campaign.version)
    response.headers["Location"] = str(request.url_for("get_campaign", campaign_id=campaign.id))
    return await run_in_threadpool(view, lab, campaign)


@router.get(
    "/campaigns/{campaign_id}/bundle",
    response_class=FileResponse,
    responses={200: {"content": {_ZIP: {"schema": {"type": "string", "format": "binary"}}}}},
)
async def export_bundle(campaign_id: Id, lab: LabOf) -> FileResponse:
    """The completely recorded sweeps of a campaign."""
    folder = FilePath(await run_in_threadpool(tempfile.mkdtemp, prefix="export-", dir=lab.files.transfer()))
    try:
        await lab.export_bundle(campaign_id, folder / "bundle")
        packed = await run_in_threadpool(_pack, folder / "bundle", folder / "bundle.zip")
    except BaseException:
        await asyncio.shield(run_in_threadpool(shutil.rmtree, folder))
        raise
    return FileResponse(
        packed,
        media_type=_ZIP,
        filename=f"campaign-{campaign_id}.zip",
        background=BackgroundTask(shutil.rmtree, folder),
    )


@contextmanager
def _temporary_folder(parent: FilePath) -> Generator[FilePath]:
    with tempfile.TemporaryDirectory(prefix="import-", dir=parent) as name:
        yield FilePath(name)


def _unpack(content: bytes, folder: FilePath) -> None:
    """Unpack into `folder`; member names that would leave it are cut by `zipfile` itself."""
    try:
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            size = sum(member.file_size for member in archive.infolist())
            if size > _MAX_UNPACKED:
                raise BadInput("bundle", f"unpacks to {size} bytes, limit {_MAX_UNPACKED} bytes")
            archive.extractall(folder)
    except (zipfile.BadZipFile, zlib.error, EOFError, lzma.LZMAError, NotImplementedError, RuntimeError) as error:
        raise BadInput("bundle", f"cannot be unpacked: {error}") from None
    except OSError as error:
        if error.errno not in _BAD_MEMBER:
            raise
        raise BadInput("bundle", f"cannot be unpacked: {error.strerror or error}") from None


def _pack(folder: FilePath, target: FilePath) -> FilePath:
    with zipfile.ZipFile(target, "w", zipfile.ZIP_STORED) as archive:  # Parquet is compressed already
        for path in sorted(folder.rglob("*")):
            archive.write(path, path.relative_to(folder))
    return target


def _own_place(text: str, folder: FilePath) -> str:
    return text.replace(f"{folder}/", "").replace(str(folder), "bundle")
