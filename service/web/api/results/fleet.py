"""Robots of the plant over their campaigns: changes, differences from the other robots, due measurements."""

from typing import Annotated

from fastapi import APIRouter, Query, Response

from service.identification.fleet.document import Fleet
from service.web.api.dependencies import ApplicationOf
from service.web.api.results.reports import FILES, FORMS, HTML, ReportFile, file_of

router = APIRouter(prefix="/fleet", tags=["fleet"])

OfType = Annotated[
    str | None, Query(alias="type", min_length=1, max_length=200, description="name of the robots; default: all types")
]


@router.get("")
def get_fleet(application: ApplicationOf, name: OfType = None) -> Fleet:
    """Uses the newest estimate of each finished campaign, of all machines of the plant. 404 for an unknown type.

    Campaigns are compared in their common poses. Excluded are initial analyses, trajectories, and the experiments of a
    diagnosis, which may have a test mass on the robot.
    """
    return application.fleet(name)


@router.get("/report", response_class=Response, responses=HTML)
async def get_fleet_report(application: ApplicationOf, name: OfType = None) -> Response:
    """One HTML file with a control chart for each axis; it needs no network."""
    return Response(await application.fleet_report(name, "html"), media_type="text/html")


@router.get("/report.{ending}", response_class=Response, responses=FILES)
async def get_fleet_report_file(ending: ReportFile, application: ApplicationOf, name: OfType = None) -> Response:
    """501 if the service cannot make PDF."""
    return file_of(await application.fleet_report(name, FORMS[ending]), ending, "fleet")
