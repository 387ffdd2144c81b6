"""Pairs of campaigns of one plan, without and with a body on the last link: its mass, centre and inertia.

A request moves nothing: it is computed from two completed campaigns.
"""

from typing import Annotated

from fastapi import APIRouter, Request, Response
from pydantic import BaseModel, ConfigDict, Field

from service import BadInput
from service.formats.export.sheets.inertias import load_of
from service.formats.export.sheets.text import load_page
from service.store.access import LOCAL, Role
from service.store.documents import LARGEST_ID
from service.store.plant import PayloadDocument, PayloadEntry
from service.web.api.dependencies import (
    After,
    BatchesOf,
    CallerOf,
    Id,
    IdempotentRoute,
    Limit,
    Page,
    ReidentifyingOf,
    download,
    media,
    page,
)
from service.web.api.route_roles import allow

payload_routes = APIRouter(prefix="/payloads", tags=["payloads"], route_class=IdempotentRoute)
Number = Annotated[int, Field(ge=1, le=LARGEST_ID)]


class WantedPayload(BaseModel):
    """Completed campaigns of one plan: `before` without the payload, `after` with it."""

    model_config = ConfigDict(extra="forbid")
    before: Number
    after: Number


class PayloadView(PayloadDocument):
    """A payload with its document. `no_sheet`: why no control takes it; empty: there is a sheet, null: no result."""

    no_sheet: str | None


@payload_routes.post("", status_code=202)
@allow(Role.ENGINEER)
async def add_payload(
    wanted: WantedPayload, request: Request, response: Response, batches: ReidentifyingOf, by: CallerOf
) -> PayloadView:
    """Identify a payload. Returns immediately; an event of the kind `batch` reports its end."""
    payload = await batches.request_payload(wanted.before, wanted.after, by or LOCAL)
    response.headers["Location"] = str(request.url_for("get_payload", payload_id=payload.id))
    return _view(payload)


@payload_routes.get("")
@allow(Role.VIEWER)
def list_payloads(batches: BatchesOf, after: After = 0, limit: Limit = 50) -> Page[PayloadEntry]:
    """Payloads of all machines of the plant, without their documents."""
    return page(batches.payloads(after, limit), limit)


@payload_routes.get("/{payload_id}")
@allow(Role.VIEWER)
def get_payload(payload_id: Id, batches: BatchesOf) -> PayloadView:
    return _view(batches.payload(payload_id))


@payload_routes.get(
    "/{payload_id}/sheet.md", response_class=Response, responses=media("text/markdown", schema={"type": "string"})
)
@allow(Role.VIEWER)
def get_payload_sheet(payload_id: Id, batches: BatchesOf) -> Response:
    """The fields of the controls. 409 until there is a result; 422 if no control can take it."""
    sheet = load_page(load_of(batches.payload(payload_id).found, f"payload {payload_id}"))
    return download(sheet, "text/markdown", f"payload-{payload_id}-sheet.md")


def _view(payload: PayloadDocument) -> PayloadView:
    no_sheet = None
    if payload.document is not None:
        try:
            load_of(payload.found, f"payload {payload.id}")
            no_sheet = ""
        except BadInput as error:
            no_sheet = str(error)
    return PayloadView(**payload.model_dump(), no_sheet=no_sheet)
