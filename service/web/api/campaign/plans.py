"""Plans: the sweeps, their poses and their order. A plan that leaves the safety envelope is refused."""

from typing import Annotated, cast

from fastapi import APIRouter, Request, Response
from pydantic import Discriminator, JsonValue, Tag, computed_field

from service.identification.estimates.analysis_document import analyses_from
from service.model.errors import BadInput
from service.model.geometry.cell import read_cell
from service.model.results.analysis import Analyses
from service.model.results.stored_json import JsonOf
from service.planning.analysis import build_analysis_plan
from service.planning.campaigns.stored_plan import planned_times
from service.planning.campaigns.stored_results import check_beside, latest_analysis
from service.planning.compiled_plan import Plan, other_machine
from service.planning.diagnosis import build_diagnosis_plan
from service.planning.documents import AnalysisRequest, DiagnosisRequest, PlanRequest, TrajectoryRequest
from service.planning.machine_setup import narrowed, on_machine
from service.planning.plan import build_plan
from service.planning.trajectories import build_trajectory_plan
from service.store.documents import PlanRecord
from service.web.api.campaign.confirmation import Typed
from service.web.api.campaign.progress import expected_time
from service.web.api.dependencies import After, ApplicationOf, Id, Limit, Page, page, who_asks
from service.web.api.idempotent import IdempotentRoute
from service.web.api.problem import TAG
from service.web.application import Application


def _kind(body: object) -> str:
    given = cast("dict[str, object]", body).get("kind") if isinstance(body, dict) else getattr(body, "kind", None)
    return f"{TAG}{given}" if given in ("analysis", "trajectory", "diagnosis") else f"{TAG}sweeps"


Wanted = Annotated[
    Annotated[AnalysisRequest, Tag(f"{TAG}analysis")]
    | Annotated[TrajectoryRequest, Tag(f"{TAG}trajectory")]
    | Annotated[DiagnosisRequest, Tag(f"{TAG}diagnosis")]
    | Annotated[PlanRequest, Tag(f"{TAG}sweeps")],
    Discriminator(_kind),
]


class PlanView(PlanRecord):
    """A stored plan; its request selects the kind of `document`. `expected_time`: s, with the check moves."""

    document: Annotated[dict[str, JsonValue], JsonOf(Plan)]

    @computed_field
    @property
    def expected_time(self) -> float:
        """Remaining time of a campaign of this plan before its start, s."""
        return expected_time(planned_times(self))


router = APIRouter(prefix="/plans", tags=["plans"], route_class=IdempotentRoute)


@router.post("", status_code=201, response_model=PlanView)
def add_plan(
    wanted: Wanted,
    request: Request,
    response: Response,
    application: ApplicationOf,
    typed: Typed,
    elsewhere: bool = False,
) -> PlanRecord:
    """Choose poses and excitation, and store the plan. This takes seconds to minutes; nothing moves.

    `kind` "analysis": an initial analysis. A plan of sweeps can use the campaign of an initial analysis (`analysis`).
    `kind` "trajectory": exciting trajectories of several axes at the same time. `kind` "diagnosis": all kinds of sweeps
    in a few poses, for a diagnosis.

    The robot must match the drives of this service: gear ratios, rated efforts, limits. `elsewhere`: the plan is for
    another machine (part programs of a CNC); a campaign of it cannot be started here.

    409 `needs-confirmation` if robot or cell is not the machine's: `confirm` says which names a person has to type.
    """
    setup, origin = application.own.setup, application.store.robot(wanted.robot_id)
    robot = origin.build()
    other = "" if elsewhere else other_machine(robot, wanted.robot_id, application.settings, setup.axes, _moved(wanted))
    if other:
        raise BadInput("robot_id", f"belongs to another machine: {other}")
    wanted = wanted.model_copy(update={"cell": setup.own_cell(wanted.cell)})
    cell = read_cell(application.settings.cells_dir / f"{wanted.cell}.yaml")
    made_for = None
    if not elsewhere:
        confirmed = setup.confirmed(origin, wanted.cell, typed, who_asks(request, application))
        made_for = confirmed.model_copy(update={"narrowed": narrowed(robot, setup.axes)})
        robot = on_machine(robot, setup.axes)
    if isinstance(wanted, AnalysisRequest):
        document = build_analysis_plan(robot, _with_excitation(wanted, application), cell)
    elif isinstance(wanted, TrajectoryRequest):
        if wanted.sweeps is not None:
            check_beside(application.store, wanted.sweeps, wanted.robot_id)
        document = build_trajectory_plan(robot, wanted, cell)
    elif isinstance(wanted, DiagnosisRequest):
        document = build_diagnosis_plan(robot, wanted, cell)
    else:
        analysed: Analyses = {} if wanted.analysis is None else latest_analysis(application.store, wanted.analysis)
        document = build_plan(robot, wanted, cell, analyses_from(analysed))
    document = document.model_copy(update={"made_for": made_for})
    plan = application.store.add_plan(wanted.robot_id, document.model_dump(mode="json"))
    response.headers["Location"] = str(request.url_for("get_plan", plan_id=plan.id))
    return plan


def _moved(wanted: PlanRequest | AnalysisRequest | TrajectoryRequest | DiagnosisRequest) -> tuple[str, ...]:
    return wanted.axes if isinstance(wanted, TrajectoryRequest) else (*wanted.axes, *wanted.varied)


def _with_excitation(wanted: AnalysisRequest, application: Application) -> AnalysisRequest:
    """The request with an excitation that the machine supports; noise if the machine is not known."""
    if wanted.excitation is not None:
        return wanted
    able = not application.machine.connected or application.machine.capabilities.torque_injection
    return wanted.model_copy(update={"excitation": "noise" if able else "stepped_sine"})


@router.get("", response_model=Page[PlanView])
def list_plans(application: ApplicationOf, after: After = 0, limit: Limit = 50) -> Page[PlanRecord]:
    return page(application.store.plans(after, limit), limit)


@router.get("/{plan_id}", response_model=PlanView)
def get_plan(plan_id: Id, application: ApplicationOf) -> PlanRecord:
    return application.store.plan(plan_id)
