"""Reports of campaigns and diagnoses: one HTML page, a PDF, or the tables only."""

from enum import StrEnum
from typing import Any

from fastapi import APIRouter, Response

from service.report import Form
from service.web.api.dependencies import ApplicationOf, Id

router = APIRouter(tags=["reports"])


class ReportFile(StrEnum):
    """Selected by the file extension: PDF (A4), or all tables of the report, by section, as text in JSON."""

    PDF = "pdf"
    JSON = "json"


HTML: dict[int | str, dict[str, Any]] = {200: {"content": {"text/html": {"schema": {"type": "string"}}}}}
_TABLE = {"section": "Estimate", "head": ["sweep", "J, kg m²"], "rows": [["0001", "642"]]}
_TABLES = {"title": "Inertias of the robot max100-class", "tables": [_TABLE]}
FILES: dict[int | str, dict[str, Any]] = {
    200: {
        "content": {
            "application/pdf": {"schema": {"type": "string", "format": "binary"}},
            "application/json": {"schema": {"type": "object"}, "examples": {"answer": {"value": _TABLES}}},
        }
    }
}
FORMS: dict[ReportFile, Form] = {ReportFile.PDF: "pdf", ReportFile.JSON: "json"}


@router.get("/campaigns/{campaign_id}/report", response_class=Response, responses=HTML)
async def get_campaign_report(campaign_id: Id, application: ApplicationOf) -> Response:
    """One HTML file of the latest estimate; it needs no network. 409 until a sweep is identified."""
    return Response(await application.campaign_report(campaign_id, "html"), media_type="text/html")


@router.get("/campaigns/{campaign_id}/report.{ending}", response_class=Response, responses=FILES)
async def get_campaign_report_file(campaign_id: Id, ending: ReportFile, application: ApplicationOf) -> Response:
    """409 until a sweep is identified; 501 if the service cannot make PDF."""
    written = await application.campaign_report(campaign_id, FORMS[ending])
    return file_of(written, ending, f"campaign-{campaign_id}")


@router.get("/diagnoses/{diagnosis_id}/report.html", response_class=Response, responses=HTML)
async def get_diagnosis_report(diagnosis_id: Id, application: ApplicationOf) -> Response:
    """One HTML file; it needs no network. 409 until the diagnosis is done."""
    return Response(await application.diagnosis_report(diagnosis_id, "html"), media_type="text/html")


@router.get("/diagnoses/{diagnosis_id}/report.{ending}", response_class=Response, responses=FILES)
async def get_diagnosis_report_file(diagnosis_id: Id, ending: ReportFile, application: ApplicationOf) -> Response:
    """409 until the diagnosis is done; 501 if the service cannot make PDF."""
    written = await application.diagnosis_report(diagnosis_id, FORMS[ending])
    return file_of(written, ending, f"diagnosis-{diagnosis_id}")


def file_of(written: str | bytes, ending: ReportFile, name: str) -> Response:
    """The answer with the file of a report."""
    disposition = {"Content-Disposition": f'attachment; filename="{name}-report.{ending.value}"'}
    return Response(written, media_type=f"application/{ending.value}", headers=disposition)
