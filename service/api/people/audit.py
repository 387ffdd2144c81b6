"""The audit, for admins: who asked for what, from where, and what came of it."""

from fastapi import APIRouter

from service.api.dependencies import After, ApplicationOf, Limit, Page
from service.store.people.audit import AuditDocument

router = APIRouter(prefix="/audit", tags=["people"])

_PATIENCE = 5.0  # s for what waits to be written


@router.get("")
def list_audit(application: ApplicationOf, after: After = 0, limit: Limit = 50) -> Page[AuditDocument]:
    """Entries, oldest first. A change has two: `request` before it is done, `outcome` with its status afterwards.

    503 where the table cannot be read.
    """
    application.audit.settle(_PATIENCE)
    found = application.audit.store.documents(after, limit)
    return Page(items=found, next=found[-1].number if len(found) == limit else None)
