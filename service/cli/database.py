"""The service's database, for commands that work beside it."""

import json
import sys
from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path

from sqlalchemy.exc import SQLAlchemyError

from service import BadInput
from service.process.settings import Settings, load_settings
from service.store.access import Role
from service.store.database import Database, open_database, parsed_url
from service.store.people.users import KeyDocument, SessionStore, UserDocument


@contextmanager
def opened(config: Path | None, data_dir: Path | None, make: bool = False) -> Generator[Database]:
    """The service may run meanwhile. BadInput where there is no database; `make`: then one is made."""
    settings = settings_of(config, data_dir)
    file = parsed_url(settings.url)
    if not make and file.get_backend_name() == "sqlite" and not Path(file.database or "").is_file():
        raise BadInput(str(file.database), "the database does not exist: give its folder with --data-dir or --config")
    try:
        with open_database(settings.url, settings.database_password_file, machine=None) as database:
            yield database
    except SQLAlchemyError as error:
        reason = str(getattr(error, "orig", None) or type(error).__name__)
        raise BadInput(file.render_as_string(hide_password=True), reason) from None


def audit_heads_file(config: Path | None, data_dir: Path | None) -> Path:
    """File with the heads of the audit that the service wrote; it may not exist."""
    return settings_of(config, data_dir).audit_heads_file


def session_store(database: Database, config: Path | None) -> SessionStore:
    """With the times of the settings."""
    settings = load_settings(config)
    return SessionStore(database, settings.session_idle, settings.session_longest)


def print_credential(kind: str, of: UserDocument | KeyDocument, role: Role, trouble: str) -> None:
    """A user or a key as a JSON line."""
    line = {"kind": kind, **of.model_dump(mode="json"), "role": role.word, "trouble": trouble}
    sys.stdout.write(f"{json.dumps(line)}\n")


def settings_of(config: Path | None, data_dir: Path | None) -> Settings:
    """As `sweepid serve` takes them."""
    return load_settings(config).model_copy(update={} if data_dir is None else {"data_dir": data_dir})
