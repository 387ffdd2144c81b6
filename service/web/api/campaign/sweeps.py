"""Sweeps of a campaign and their recordings."""

import re
from typing import Annotated

from fastapi import APIRouter, Path
from fastapi.responses import FileResponse

from service.store.documents import LARGEST_ID, RecordingDocument, SweepDocument
from service.web.api.dependencies import ApplicationOf, Id

router = APIRouter(prefix="/campaigns/{campaign_id}/sweeps", tags=["sweeps"])

Number = Annotated[int, Path(ge=1, le=LARGEST_ID, description="1, 2, ... in the order of the plan")]
_PARQUET = "application/vnd.apache.parquet"


@router.get("")
def list_sweeps(campaign_id: Id, application: ApplicationOf) -> tuple[SweepDocument, ...]:
    """All sweeps, in the order of the plan."""
    application.store.campaign(campaign_id)  # NotFound: an unknown campaign must not look like one without sweeps
    return application.store.sweeps(campaign_id)


@router.get("/{number}")
def get_sweep(campaign_id: Id, number: Number, application: ApplicationOf) -> SweepDocument:
    return application.store.sweep(campaign_id, number)


@router.get("/{number}/recording")
def get_recording(campaign_id: Id, number: Number, application: ApplicationOf) -> RecordingDocument:
    """The latest recording of a sweep: its extent and its SHA-256."""
    return application.store.recording(campaign_id, number)


@router.get(
    "/{number}/recording/file",
    response_class=FileResponse,
    responses={200: {"content": {_PARQUET: {"schema": {"type": "string", "format": "binary"}}}}},
)
def get_recording_file(campaign_id: Id, number: Number, application: ApplicationOf) -> FileResponse:
    """The samples as Parquet, with the columns of the bundle format; only a part of them for a partial recording."""
    recording = application.store.recording(campaign_id, number)
    name = re.sub(r"\W+", "-", f"campaign-{campaign_id}-sweep-{number:04d}-attempt-{recording.attempt}") + ".parquet"
    return FileResponse(
        application.files.local(recording),
        media_type=_PARQUET,
        filename=name,
        headers={"X-Content-SHA256": recording.sha256, "X-Recording-State": recording.state.value},
    )
