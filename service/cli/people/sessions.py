"""`sweepid people`: who is logged in, and no longer."""

import json
import sys
from typing import Annotated

import typer

from service.cli.people.open_database import Config, DataDir, opened, shell_entry
from service.settings import load_settings
from service.store.database import Database
from service.store.people.sessions import SessionStore


def sessions(config: Config = None, data_dir: DataDir = None) -> None:
    """One JSON line a session in which somebody is logged in; `expires_at` moves on with each request."""
    with opened(config, data_dir) as database:
        for session in _store(database, config).all():
            printed = {**session.model_dump(mode="json", exclude={"disabled", "ended_at"}), "role": session.role.word}
            sys.stdout.write(f"{json.dumps(printed)}\n")


def revoke_session(
    number: Annotated[int, typer.Argument(metavar="ID", help="Number from `sweepid people sessions`.")],
    config: Config = None,
    data_dir: DataDir = None,
) -> None:
    """From now on that browser has to log in again."""
    with opened(config, data_dir) as database:
        ended = _store(database, config).end(number, shell_entry())
    sys.stdout.write(f"{ended.id}\n")


def _store(database: Database, config: Config) -> SessionStore:
    settings = load_settings(config)
    return SessionStore(database, settings.session_idle, settings.session_longest)
