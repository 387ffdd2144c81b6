"""Diagnoses: where a robot's model and its measurement differ, the missing effects, and the next experiment.

A request for a diagnosis moves nothing: it is computed from campaigns that are over. An experiment moves the machine:
it starts with a person's approval, and is then a campaign like any other (pause, abort, stop).
"""

from typing import Annotated

import yaml
from fastapi import APIRouter, Query, Request, Response
from pydantic import BaseModel, ConfigDict, Field, JsonValue
from starlette.concurrency import run_in_threadpool

from service import Conflict
from service.jobs import experiments
from service.jobs.diagnosing import Start
from service.planning.compiled_plan import Range
from service.planning.documents import CELL_NAME
from service.report.diagnosis import diagnosis_figures
from service.store.access import PersonName, Role
from service.store.documents import LARGEST_ID, BoltedMass, DiagnosisDocument, DiagnosisEntry, ModelDocument, PlanRecord
from service.web.api.campaigns import CampaignView, view
from service.web.api.dependencies import (
    After,
    ApplicationOf,
    CallerOf,
    DiagnosesOf,
    DiagnosingOf,
    ExperimentsOf,
    Id,
    IdempotentRoute,
    IntentionOf,
    Limit,
    ModelsOf,
    Page,
    SettingsOf,
    StoreOf,
    download,
    media,
    page,
    set_etag,
)
from service.web.api.plans import PlanView, Typed
from service.web.api.route_roles import allow

diagnosis_routes = APIRouter(prefix="/diagnoses", tags=["diagnoses"], route_class=IdempotentRoute)
model_routes = APIRouter(prefix="/models", tags=["diagnoses"])
Number = Annotated[int, Field(ge=1, le=LARGEST_ID)]
CellName = Annotated[str, Field(pattern=CELL_NAME)]


class _Body(BaseModel):
    model_config = ConfigDict(extra="forbid", allow_inf_nan=False)


class WantedDiagnosis(_Body):
    """All complete sweeps of `campaigns`, which are over and of one robot; `axes` null: all axes that moved.

    `model`: number of the accepted model to start from; null: the nominal model. `start`: the rigid model is that of
    the robot's latest estimate that does not use these campaigns, or the CAD model; `estimate` in the answer shows it.
    `unattended`: proposed experiments run without approval; only a service whose settings declare its machine virtual
    allows it.
    """

    campaigns: tuple[Number, ...] = Field(min_length=1, max_length=100)
    axes: tuple[str, ...] | None = Field(default=None, min_length=1)
    model: Number | None = None
    start: Start = Start.ESTIMATE
    unattended: bool = False


class PlanOfExperiment(_Body):
    """`cell` null: the cell of the machine."""

    axis: str
    cell: CellName | None = None


class Approval(PlanOfExperiment):
    """The person who checked the machine, `range` of GET ahead that was shown (`seen`), and the mounted mass if the
    experiment requires one.
    """

    approved_by: PersonName
    seen: dict[str, Range] | None = Field(default=None, max_length=100)
    test_mass: BoltedMass | None = None


class Acceptance(_Body):
    """`axes` null: all axes whose effect is named and proven."""

    accepted_by: PersonName
    axes: tuple[str, ...] | None = Field(default=None, min_length=1)


class PlotlyFigure(BaseModel):
    """The arguments of `Plotly.newPlot`. The layout has a "height" in px."""

    data: list[dict[str, JsonValue]]
    layout: dict[str, JsonValue]


class Figures(BaseModel):
    """Plotly figures by joint and name, as in the report."""

    axes: dict[str, dict[str, PlotlyFigure]]


@diagnosis_routes.post("", status_code=202)
@allow(Role.ENGINEER)
async def add_diagnosis(
    wanted: WantedDiagnosis,
    request: Request,
    response: Response,
    settings: SettingsOf,
    diagnosing: DiagnosingOf,
    experiments: ExperimentsOf,
    intention: IntentionOf,
) -> DiagnosisDocument:
    """Start a diagnosis. It takes seconds per axis; an event reports its end."""
    if wanted.unattended and not settings.virtual_machine:
        raise Conflict(
            "unattended experiments are allowed only on virtual machines; the settings do not mark "
            "this machine as virtual"
        )
    diagnosis = await diagnosing.request(wanted.campaigns, wanted.axes, wanted.model, wanted.unattended, wanted.start)
    if wanted.unattended:  # before its first event is heard: no await in between
        experiments.permit(diagnosis.id, intention)
    response.headers["Location"] = str(request.url_for("get_diagnosis", diagnosis_id=diagnosis.id))
    return diagnosis


@diagnosis_routes.get("")
@allow(Role.VIEWER)
def list_diagnoses(
    diagnoses: DiagnosesOf,
    machine: Annotated[str | None, Query(max_length=64, description="only those of this machine")] = None,
    after: After = 0,
    limit: Limit = 50,
) -> Page[DiagnosisEntry]:
    """Diagnoses of all machines of the plant, or of one machine; without their documents."""
    return page(diagnoses.diagnoses(after, limit, machine), limit)


@diagnosis_routes.get("/{diagnosis_id}")
@allow(Role.VIEWER)
def get_diagnosis(diagnosis_id: Id, diagnoses: DiagnosesOf) -> DiagnosisDocument:
    return diagnoses.diagnosis(diagnosis_id)


@diagnosis_routes.get("/{diagnosis_id}/figures")
@allow(Role.VIEWER)
def get_diagnosis_figures(diagnosis_id: Id, diagnoses: DiagnosesOf) -> Figures:
    """409 until the diagnosis is done."""
    return Figures.model_validate({"axes": diagnosis_figures(diagnoses.diagnosis(diagnosis_id).found())})


@diagnosis_routes.post("/{diagnosis_id}/plan", status_code=201, response_model=PlanView)
@allow(Role.ENGINEER)
def plan_experiment(
    diagnosis_id: Id,
    wanted: PlanOfExperiment,
    request: Request,
    response: Response,
    store: StoreOf,
    experiments: ExperimentsOf,
    by: CallerOf,
    typed: Typed,
) -> PlanRecord:
    """Store the plan of an axis's next experiment, for review. Nothing moves. 409 `needs-confirmation` as a plan."""
    plan = experiments.plan(diagnosis_id, wanted.axis, wanted.cell, typed, by)
    record = store.add_plan(plan.request.robot_id, plan.model_dump(mode="json"))
    response.headers["Location"] = str(request.url_for("get_plan", plan_id=record.id))
    return record


@diagnosis_routes.post("/{diagnosis_id}/experiment", status_code=201)
@allow(Role.ENGINEER)
async def approve_experiment(
    diagnosis_id: Id,
    approval: Approval,
    request: Request,
    response: Response,
    application: ApplicationOf,
    experiments: ExperimentsOf,
    intention: IntentionOf,
    typed: Typed,
) -> CampaignView:
    """Plan the next experiment of an axis, start to move and measure. When it is completed, the diagnosis continues."""
    campaign = await experiments.approve(
        diagnosis_id,
        approval.axis,
        approval.approved_by,
        approval.test_mass,
        approval.cell,
        intention,
        typed,
        approval.seen,
    )
    response.headers["Location"] = str(request.url_for("get_campaign", campaign_id=campaign.id))
    set_etag(response, campaign.version)
    return await run_in_threadpool(view, application, campaign)


@diagnosis_routes.post("/{diagnosis_id}/model", status_code=201)
@allow(Role.ENGINEER)
def accept_model(
    diagnosis_id: Id,
    wanted: Acceptance,
    request: Request,
    response: Response,
    store: StoreOf,
    diagnoses: DiagnosesOf,
    models: ModelsOf,
) -> ModelDocument:
    """Accept named effects into the robot's model. 409 for an axis without a named effect or with removed ones."""
    model = experiments.accept_model(store, diagnoses, models, diagnosis_id, wanted.axes, wanted.accepted_by)
    response.headers["Location"] = str(request.url_for("get_model_revision", model_id=model.id))
    return model


@model_routes.get("")
@allow(Role.VIEWER)
def list_model_revisions(
    models: ModelsOf,
    robot: Annotated[int | None, Query(ge=1, le=LARGEST_ID, description="only models of this robot")] = None,
    after: After = 0,
    limit: Limit = 50,
) -> Page[ModelDocument]:
    return page(models.models(robot, after, limit), limit)


@model_routes.get("/{model_id}")
@allow(Role.VIEWER)
def get_model_revision(model_id: Id, models: ModelsOf) -> ModelDocument:
    return models.model(model_id)


@model_routes.get(
    "/{model_id}/scenario.yaml",
    response_class=Response,
    responses=media("application/yaml", schema={"type": "object"}),
)
@allow(Role.VIEWER)
def get_model_scenario(model_id: Id, models: ModelsOf) -> Response:
    """The model as a scenario of a virtual machine; it needs the robot's description as `robot.yaml` in its folder.

    Comments at the head of the file list the parts that a scenario cannot contain.
    """
    model = models.model(model_id).content
    notes = "".join(f"# {note}\n" for note in model.notes)
    text = notes + yaml.safe_dump(model.scenario, sort_keys=False)
    return download(text, "application/yaml", f"model-{model_id}-scenario.yaml")
