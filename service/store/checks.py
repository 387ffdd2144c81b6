"""Results of the data check of finished campaigns."""

from pydantic import JsonValue
from sqlalchemy import select

from service.store import rows
from service.store import tables as t
from service.store.database import Transactions
from service.store.documents import CampaignState, EventKind, SweepState

Document = dict[str, JsonValue]

OVER = (CampaignState.MEASURED, CampaignState.COMPLETED, CampaignState.ABORTED)
COMPLETE = (SweepState.RECORDED, SweepState.IDENTIFIED)


class CheckStore(Transactions):
    """Every method is one transaction and blocks, as in `service.store.store`."""

    def document(self, campaign_id: int) -> Document | None:
        """Findings as in `sweepid check --json`; None if there are none yet."""
        query = select(t.DataCheckRow.document).where(t.DataCheckRow.campaign_id == campaign_id)
        with self._database.read() as session:
            return session.scalar(query)

    def add(self, campaign_id: int, document: Document) -> None:
        """Store the result of a job, with its event; a second result of the same campaign is ignored."""
        with self._database.write() as session:
            rows.own_campaign(session, campaign_id)
            if session.scalar(select(t.DataCheckRow.id).where(t.DataCheckRow.campaign_id == campaign_id)) is not None:
                return
            session.add(t.DataCheckRow(campaign_id=campaign_id, document=document))
            rows.emit(session, campaign_id, EventKind.DATA_CHECK, {})

    def wanting(self, campaign_id: int | None = None) -> tuple[int, ...]:
        """Finished campaigns of this machine (or this one) with complete sweeps that were not checked."""
        query = (
            select(t.CampaignRow.id)
            .join(t.SweepRow, t.SweepRow.campaign_id == t.CampaignRow.id)
            .outerjoin(t.DataCheckRow, t.DataCheckRow.campaign_id == t.CampaignRow.id)
            .where(t.CampaignRow.state.in_(OVER), t.SweepRow.state.in_(COMPLETE), t.DataCheckRow.id.is_(None))
            .distinct()
            .order_by(t.CampaignRow.id)
        )
        if campaign_id is not None:
            query = query.where(t.CampaignRow.id == campaign_id)
        with self._database.read() as session:
            return tuple(session.scalars(query.where(rows.of_own(session))))
