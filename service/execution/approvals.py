"""The first of two steps to a start, where the setting `approval` wants it: somebody approved what will move."""

from datetime import timedelta

from service.errors import BadInput, Conflict
from service.store.approvals import ApprovalDocument, ApprovalStore
from service.store.tables import now


class Approvals:
    """Blocks, for it asks the store. `by`: who starts, where the service knows it; "" where it asks nobody."""

    def __init__(self, store: ApprovalStore, needed: bool, valid: timedelta) -> None:
        """`valid`: for how long an approval holds."""
        self._store, self.needed, self._valid = store, needed, valid

    def add(self, plan_id: int, shown: str, sha256: str, approved_by: str) -> ApprovalDocument:
        """`shown`: the hash of what the person saw. Conflict if that is not the present one."""
        if not approved_by:
            raise BadInput("approved_by", "the service asks nobody who he is: say who approves")
        if shown != sha256:
            raise Conflict(f"plan {plan_id} moves something else than what was looked at: look again ({sha256})")
        return self._store.add(plan_id, sha256, approved_by, self._valid)

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
            return f"plan {plan_id} is approved by {by} alone: another one must approve it, or start it"
        reason = found[0].trouble(sha256, at) if found else "nobody has"
        return f"an engineer must approve plan {plan_id} first: {reason}"

    def check(self, plan_id: int | None, sha256: str, by: str) -> None:
        """Conflict unless the motion may be started."""
        reason = "" if plan_id is None else self.missing(plan_id, sha256, by)
        if reason:
            raise Conflict(reason)
