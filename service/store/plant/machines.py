"""The machines of a plant, and their state in the database."""

from sqlalchemy import func, select

from service.store import rows
from service.store import tables as t
from service.store.database import Transactions
from service.store.documents import CampaignState, StoredDocument


class MachineDocument(StoredDocument):
    """A machine of the plant, with robot and cell as its service has them configured; null: not configured.

    `here`: it is the machine of this service. `robot`: the robot's name.
    """

    name: str
    here: bool
    robot_id: int | None
    robot: str | None
    cell: str | None


class PlantStore(Transactions):
    """Every method is one transaction and blocks."""

    def machines(self) -> tuple[MachineDocument, ...]:
        """In the order in which they were added."""
        machine, robot = t.MachineRow, t.RobotRow
        query = select(machine.id, machine.name, machine.robot_id, robot.name, machine.cell)
        query = query.outerjoin(robot, robot.id == machine.robot_id).order_by(machine.id)
        with self._database.read() as session:
            own = rows.owned(session)
            return tuple(
                MachineDocument(name=name, here=own is not None and own.id == key, robot_id=number, robot=of, cell=cell)
                for key, name, number, of, cell in session.execute(query)
            )

    def configure(self, robot_id: int | None, cell: str | None) -> None:
        """Store robot and cell of this service's machine, if they have changed. Raises NoMachine."""
        with self._database.write(quiet=True) as session:
            row = rows.get(session, t.MachineRow, rows.own(session), "machine")
            row.robot_id, row.cell = robot_id, cell

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
