"""First of two steps to a start, with the setting `approval`: a person approves the motion."""

from collections.abc import Callable
from datetime import timedelta

from service.model.errors import BadInput, Conflict
from service.store.guards import ApprovalDocument, ApprovalStore
from service.store.tables import now


class Approvals:
    """Blocking, because it reads the store. `by`: the authenticated person who starts; "" without login."""

    def __init__(self, store: ApprovalStore, needed: bool, valid: timedelta) -> None:
        """`valid`: how long an approval is valid."""
        self._store, self.needed, self._valid = store, needed, valid

    def add(
        self, plan_id: int, shown: str, sha256: str, approved_by: str, wanted: Callable[[], None]
    ) -> ApprovalDocument:
        """`shown`: the hash of the content displayed to the person. Raises Conflict if it is not the present one.

        `wanted` raises Superseded; it is called in the transaction, for which the approval may have waited.
        """
        if not approved_by:
            raise BadInput("approved_by", "login is disabled: give the name of the person who approves")
        if shown != sha256:
            raise Conflict(f"plan {plan_id} changed after it was displayed: review it again ({sha256})")
        return self._store.add(plan_id, sha256, approved_by, self._valid, wanted)

    def of_plan(self, plan_id: int) -> tuple[ApprovalDocument, ...]:
        return self._store.of_plan(plan_id)

    def missing(self, plan_id: int, sha256: str, by: str = "") -> str:
        """Why a motion of the plan with this hash may not be started; empty if it may."""
        if not self.needed:
            return ""
        found = self._store.of_plan(plan_id)
        at = now()
        good = [approval for approval in found if not approval.trouble(sha256, at)]
        if good and (not by or any(approval.approved_by != by for approval in good)):
            return ""
        if good:
            return f"plan {plan_id} is approved by {by} alone: another person must approve it, or start it"
        reason = found[0].trouble(sha256, at) if found else "not approved yet"
        return f"plan {plan_id} requires the approval of an engineer: {reason}"

    def check(self, plan_id: int | None, sha256: str, by: str) -> None:
        """Raises Conflict unless the motion may be started."""
        reason = "" if plan_id is None else self.missing(plan_id, sha256, by)
        if reason:
            raise Conflict(reason)
