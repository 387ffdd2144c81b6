"""Which robots of a plant were measured when, with which estimate."""

from dataclasses import dataclass
from datetime import datetime

from sqlalchemy import func, select

from service.store import tables as t
from service.store.database import Database
from service.store.documents import CampaignState, EstimateDocument
from service.store.store import Store

_OVER = (CampaignState.MEASURED, CampaignState.COMPLETED)


@dataclass(frozen=True, slots=True)
class RobotNamed:
    """A robot of a plant. `serial`: None if its file has none; then the machine identifies the robot."""

    name: str
    serial: str | None
    machine: str


@dataclass(frozen=True, slots=True)
class MeasuredCampaign:
    """A campaign that measured a robot, and the newest revision of its estimate. `at`: its start."""

    id: int
    revision: int
    robot: RobotNamed
    at: datetime


class FleetStore:
    """Reads only; every method is one transaction and blocks."""

    def __init__(self, database: Database) -> None:
        self._database, self._store = database, Store(database)

    def types(self) -> tuple[str, ...]:
        """Names of the robots in the database, sorted: robots with one name are of one type."""
        with self._database.read() as session:
            return tuple(session.scalars(select(t.RobotRow.name).distinct().order_by(t.RobotRow.name)))

    def serials(self, name: str) -> tuple[str, ...]:
        """Serial numbers of the robots with this name that have one, measured or not."""
        row = t.RobotRow
        query = select(row.serial).distinct().where(row.name == name, row.serial.is_not(None)).order_by(row.serial)
        with self._database.read() as session:
            return tuple(serial for serial in session.scalars(query) if serial is not None)

    def measured(self, name: str) -> tuple[MeasuredCampaign, ...]:
        """Finished campaigns with an estimate of robots with this name, the oldest first.

        Imported ones and those of plans for the inertia. Not those of an initial analysis, of a trajectory, or of a
        diagnosis, whose experiments may have a test mass on the robot.
        """
        campaign, robot, plan = t.CampaignRow, t.RobotRow, t.PlanRow
        at = func.coalesce(campaign.started_at, campaign.created_at)
        newest = (
            select(t.EstimateRow.campaign_id, func.max(t.EstimateRow.revision).label("revision"))
            .group_by(t.EstimateRow.campaign_id)
            .subquery()
        )
        query = (
            select(
                campaign.id,
                newest.c.revision,
                robot.name,
                robot.serial,
                t.MachineRow.name,
                campaign.started_at,
                campaign.created_at,
            )
            .join(newest, newest.c.campaign_id == campaign.id)
            .join(robot, robot.id == campaign.robot_id)
            .join(t.MachineRow, t.MachineRow.id == campaign.machine_id)
            .outerjoin(plan, plan.id == campaign.plan_id)
            .where(robot.name == name, campaign.state.in_(_OVER))
            .where(plan.document["request"]["kind"].as_string().is_(None))
            .order_by(at, campaign.id)
        )
        with self._database.read() as session:
            return tuple(
                MeasuredCampaign(number, revision, RobotNamed(robot_name, serial, machine), started or created)
                for number, revision, robot_name, serial, machine, started, created in session.execute(query)
            )

    def estimate(self, campaign: MeasuredCampaign) -> EstimateDocument:
        """Raises NotFound if it was removed meanwhile."""
        return self._store.estimate(campaign.id, campaign.revision)

    def poses(self, campaign_id: int) -> dict[str, tuple[float, ...]]:
        """Poses of a campaign's sweeps, rad (m), by the name of the sweep."""
        return {sweep.spec.id: sweep.spec.pose for sweep in self._store.sweeps(campaign_id)}
