"""From a setting to the kind of the database."""

from pathlib import Path

from sqlalchemy import URL, make_url
from sqlalchemy.exc import ArgumentError

from service.model.errors import BadInput
from service.store.engines.kind import Kind
from service.store.engines.postgresql import Postgresql
from service.store.engines.sqlite import Sqlite

_SETTING = "database_url"


def kind_of(url: str, password_file: Path | None = None) -> Kind:
    """Raises BadInput for another database, a password in the URL, or a password file that cannot be read."""
    parsed = parsed_url(url)
    if parsed.get_backend_name() == "sqlite":
        return Sqlite(parsed)
    return Postgresql(parsed, None if password_file is None else _password(password_file))


def parsed_url(url: str) -> URL:
    """Raises BadInput as `kind_of`; the message never contains a possible password."""
    try:
        parsed = make_url(url)
    except (ArgumentError, ValueError):
        raise BadInput(_SETTING, "is not the URL of a database") from None
    if parsed.password is not None or "password" in parsed.query:
        raise BadInput(
            _SETTING,
            "contains a password, which would appear in logs and process lists: put it into a file "
            "and set `database_password_file` (SWEEPID_DATABASE_PASSWORD_FILE), or use libpq's "
            "PGPASSFILE",
        )
    if parsed.drivername not in ("sqlite", "postgresql+psycopg"):
        reason = f"begins with {parsed.drivername!r}; sqlite:///... and postgresql+psycopg://... are known"
        raise BadInput(_SETTING, reason)
    return parsed


def _password(file: Path) -> str:
    try:
        return file.read_text(encoding="utf-8").rstrip("\r\n")
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or type(error).__name__
        raise BadInput("database_password_file", f"{file} cannot be read: {reason}") from None
