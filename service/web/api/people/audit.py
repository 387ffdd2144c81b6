"""The audit, for admins: caller, request, address and outcome."""

from fastapi import APIRouter

from service.store.people.audit import AuditDocument
from service.web.api.dependencies import After, ApplicationOf, Limit, Page

router = APIRouter(prefix="/audit", tags=["people"])

_PATIENCE = 5.0  # s, longest wait for entries that are not yet written


@router.get("")
def list_audit(
    application: ApplicationOf, after: After = 0, limit: Limit = 50, newest: bool = False
) -> Page[AuditDocument]:
    """Entries, oldest first; with `newest` the last entries instead of those `after` a number.

    A change has two entries: `request` before it is executed, `outcome` with its status afterwards.

    503 if the table cannot be read.
    """
    application.audit.settle(_PATIENCE)
    store = application.audit.store
    found = store.newest(limit) if newest else store.documents(after, limit)
    return Page(items=found, next=found[-1].number if len(found) == limit and not newest else None)
