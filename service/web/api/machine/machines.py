"""The machines of the plant, with their robot and cell."""

from fastapi import APIRouter
from pydantic import BaseModel

from service.store.plant import MachineDocument
from service.web.api.dependencies import ApplicationOf
from service.web.api.idempotent import IdempotentRoute

router = APIRouter(prefix="/machines", tags=["drives"], route_class=IdempotentRoute)


class Machines(BaseModel):
    """`missing`: what to set so that the machine of this service has its robot and its cell; empty: nothing."""

    items: tuple[MachineDocument, ...]
    missing: tuple[str, ...]


@router.get("")
def list_machines(application: ApplicationOf) -> Machines:
    """A service plans for the robot and the cell of its own machine (`here`), unless a person confirms others."""
    missing = () if application.cell is None else application.cell.setup.missing
    return Machines(items=application.plant.machines(), missing=missing)
