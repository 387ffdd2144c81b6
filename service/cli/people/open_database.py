"""The service's database, for commands that work beside it."""

import getpass
from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated

import typer
from sqlalchemy.exc import SQLAlchemyError

from service.errors import BadInput
from service.people.audit_chain import Entry
from service.settings import Settings, load_settings
from service.store.database import Database, open_database
from service.store.engines.address import parsed_url

Config = Annotated[Path | None, typer.Option(help="Settings; default: config/service.yaml, if it exists.")]
DataDir = Annotated[Path | None, typer.Option(help="Where the service's database is.")]


@contextmanager
def opened(config: Path | None, data_dir: Path | None, make: bool = False) -> Generator[Database]:
    """The service may run meanwhile. BadInput where there is no database; `make`: then one is made."""
    settings = _settings(config, data_dir)
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
    return _settings(config, data_dir).audit_heads_file


def _settings(config: Path | None, data_dir: Path | None) -> Settings:
    settings = load_settings(config)
    return settings if data_dir is None else settings.model_copy(update={"data_dir": data_dir})


def shell_entry() -> Entry:
    """Who is at the terminal, for the audit."""
    return {"actor": f"{getpass.getuser()} (shell)", "address": "shell"}
