"""Plans: which sweeps in which poses and in which order. A plan that leaves the safety envelope is not made."""

from fastapi import APIRouter, Request, Response

from service.api.dependencies import After, Id, LabOf, Limit, Page
from service.api.idempotent import IdempotentRoute
from service.campaigns.plan import PlanRequest, build_plan
from service.cell import read_cell
from service.store.documents import PlanRecord

router = APIRouter(prefix="/plans", tags=["plans"], route_class=IdempotentRoute)


@router.post("", status_code=201)
def add_plan(wanted: PlanRequest, request: Request, response: Response, lab: LabOf) -> PlanRecord:
    """Choose poses and excitation and store the plan. Takes seconds to minutes; nothing moves."""
    robot = lab.store.robot(wanted.robot_id).build()
    cell = read_cell(lab.settings.cells_dir / f"{wanted.cell}.yaml")
    document = build_plan(robot, wanted, cell)
    plan = lab.store.add_plan(wanted.robot_id, document.model_dump(mode="json"))
    response.headers["Location"] = str(request.url_for("get_plan", plan_id=plan.id))
    return plan


@router.get("")
def list_plans(lab: LabOf, after: After = 0, limit: Limit = 50) -> Page[PlanRecord]:
    plans = lab.store.plans(after, limit)
    return Page(items=plans, next=plans[-1].id if len(plans) == limit else None)


@router.get("/{plan_id}")
def get_plan(plan_id: Id, lab: LabOf) -> PlanRecord:
    return lab.store.plan(plan_id)
