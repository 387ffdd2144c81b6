"""The machines of a plant, and their state in the database."""

from sqlalchemy import func, select

from service.store import tables as t
from service.store.database import Database
from service.store.documents import CampaignState


class PlantStore:
    """Reads only; every method is one transaction and blocks."""

    def __init__(self, database: Database) -> None:
        self._database = database

    def machines(self) -> tuple[str, ...]:
        """Names, in the order in which they were added."""
        with self._database.read() as session:
            return tuple(session.scalars(select(t.MachineRow.name).order_by(t.MachineRow.id)))

    def campaigns(self) -> dict[tuple[str, CampaignState], int]:
        """Number of campaigns by machine and state; states without campaigns are omitted."""
        machine, campaign = t.MachineRow, t.CampaignRow
        query = (
            select(machine.name, campaign.state, func.count())
            .join(campaign, campaign.machine_id == machine.id)
            .group_by(machine.name, campaign.state)
        )
        with self._database.read() as session:
            return {(name, state): count for name, state, count in session.execute(query)}

    def stops_held(self) -> dict[str, int]:
        """Number of stops that hold each machine; 0 for a machine without one."""
        machine, stop = t.MachineRow, t.StopRow
        held = (stop.machine_id == machine.id) & stop.reset_at.is_(None)
        query = select(machine.name, func.count(stop.id)).outerjoin(stop, held).group_by(machine.name)
        with self._database.read() as session:
            return dict(session.execute(query).all())
