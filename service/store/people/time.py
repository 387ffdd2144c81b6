"""The time of sessions and keys in the database: kept there, so that it does not run backward over a restart."""

import structlog
from sqlalchemy import func, select, update
from sqlalchemy.orm import Session

from service.store import tables as t
from service.store.access.steady_clock import SET_BACK
from service.store.database import Database
from service.store.people.audit import append

_log = structlog.get_logger(__name__)

_PATIENCE = 1.0  # s for another writer: the next minute comes


def keep_time(database: Database) -> None:
    """Store the time, so that a restart does not begin before it. Blocks; at least once a minute."""
    with database.write(quiet=True, patience=_PATIENCE) as session:
        keep(session, database)


def keep(session: Session, database: Database) -> None:
    """The same, within the caller's transaction."""
    row = session.get(t.SteadyTimeRow, 1)
    at = database.now(session)
    if row is None:
        session.add(t.SteadyTimeRow(id=1, at=at))
    else:
        row.at = at


def begin_time(database: Database) -> None:
    """At the start of a service: if the clock was set back while none ran, all sessions end.

    How long that was is not known, so nobody can say how much of their time is left. Keys last longer and remain: they
    expire by the time that the database keeps.
    """
    with database.write(quiet=True) as session:
        kept = session.scalar(select(t.SteadyTimeRow.at))
        wall = database.clock.wall()
        if kept is not None and wall < kept - SET_BACK:
            open_ones = t.SessionRow.ended_at.is_(None)
            ended = session.scalar(select(func.count()).select_from(t.SessionRow).where(open_ones)) or 0
            session.execute(update(t.SessionRow).where(open_ones).values(ended_at=wall))
            behind = round((kept - wall).total_seconds())
            append(session, [{"event": "clock set back", "actor": "service", "seconds": behind, "sessions": ended}])
            _log.error("clock_set_back", seconds=behind, ended_sessions=ended)
        keep(session, database)
