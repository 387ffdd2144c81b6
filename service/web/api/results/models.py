"""The identified robot of a campaign as a file for other tools, from its newest estimate."""

from enum import StrEnum

from fastapi import APIRouter, Response

from service.formats.export import model_files, model_of
from service.web.api.dependencies import ApplicationOf, Id

router = APIRouter(prefix="/campaigns/{campaign_id}", tags=["estimates"])


class ModelEnding(StrEnum):
    """Selected by the file extension: URDF, MJCF (MuJoCo), or all parameters as YAML."""

    URDF = "urdf"
    MJCF = "xml"
    YAML = "yaml"


_CONTENT = {"application/xml": {"schema": {"type": "string"}}, "application/yaml": {"schema": {"type": "object"}}}
_TYPES = {
    ModelEnding.URDF: "application/xml",
    ModelEnding.MJCF: "application/xml",
    ModelEnding.YAML: "application/yaml",
}


@router.get(
    "/model.{ending}",
    response_class=Response,
    responses={200: {"content": _CONTENT}},
)
def get_model(campaign_id: Id, ending: ModelEnding, application: ApplicationOf) -> Response:
    """404 until the first sweep is identified; 422 while no sweep gives an inertia."""
    robot = application.store.robot(application.store.campaign(campaign_id).robot_id).build()
    estimate = application.store.estimate(campaign_id)
    model = model_of(robot, estimate.content, f"estimate {estimate.revision} of campaign {campaign_id}")
    name = f"model.{ending.value}"
    disposition = {"Content-Disposition": f'attachment; filename="campaign-{campaign_id}-{name}"'}
    return Response(model_files(model)[name], media_type=_TYPES[ending], headers=disposition)
