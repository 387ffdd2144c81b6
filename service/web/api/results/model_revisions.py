"""Models of robots that people accepted from diagnoses: rigid body and effects; append-only."""

from typing import Annotated

import yaml
from fastapi import APIRouter, Query, Response

from service.store.documents import LARGEST_ID, ModelDocument
from service.web.api.dependencies import After, ApplicationOf, Id, Limit, Page, page

router = APIRouter(prefix="/models", tags=["diagnoses"])


@router.get("")
def list_model_revisions(
    application: ApplicationOf,
    robot: Annotated[int | None, Query(ge=1, le=LARGEST_ID, description="only models of this robot")] = None,
    after: After = 0,
    limit: Limit = 50,
) -> Page[ModelDocument]:
    return page(application.models.models(robot, after, limit), limit)


@router.get("/{model_id}")
def get_model_revision(model_id: Id, application: ApplicationOf) -> ModelDocument:
    return application.models.model(model_id)


@router.get(
    "/{model_id}/scenario.yaml",
    response_class=Response,
    responses={200: {"content": {"application/yaml": {"schema": {"type": "object"}}}}},
)
def get_model_scenario(model_id: Id, application: ApplicationOf) -> Response:
    """The model as a scenario of a virtual machine; it needs the robot's description as `robot.yaml` in its folder.

    Comments at the head of the file list the parts that a scenario cannot contain.
    """
    model = application.models.model(model_id).content
    notes = "".join(f"# {note}\n" for note in model.notes)
    text = notes + yaml.safe_dump(model.scenario, sort_keys=False)
    disposition = {"Content-Disposition": f'attachment; filename="model-{model_id}-scenario.yaml"'}
    return Response(text, media_type="application/yaml", headers=disposition)
