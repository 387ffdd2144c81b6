"""`sweepid people`: who may use the service from where it listens."""

import json
import sys
from datetime import timedelta
from typing import Annotated

import typer

from service.cli.people.opened import Config, DataDir, opened, shell_entry
from service.errors import BadInput
from service.people.permissions import LOCAL, Role
from service.store.people.keys import KeyStore
from service.store.tables import now

people = typer.Typer(no_args_is_help=True, rich_markup_mode=None, help="Keys for the setting `login: true`.")

_ROLES = {role.word: role for role in Role}
_TAKEN = (LOCAL, "anybody", "unknown")  # the audit means somebody else by them
_LONGEST_NAME = 100
_Name = Annotated[str, typer.Argument(metavar="NAME", help="A person or a program.")]


@people.command("add-key")
def add_key(
    name: _Name,
    role: Annotated[str, typer.Option(help=f"What the key opens: {', '.join(_ROLES)}.")],
    days: Annotated[int, typer.Option(min=1, max=3650, help="After so many days it opens nothing.")] = 90,
    config: Config = None,
    data_dir: DataDir = None,
) -> None:
    """Make a key and print it, once: only its hash is stored. To be sent as `Authorization: Bearer KEY`."""
    name = name.strip()
    if name in _TAKEN or not name.isprintable() or not 1 <= len(name) <= _LONGEST_NAME:
        raise BadInput("NAME", f"{name[:_LONGEST_NAME]!r} is not a name: 1 to {_LONGEST_NAME} printable characters")
    if role not in _ROLES:
        raise BadInput("--role", f"{role!r} is not one of {', '.join(_ROLES)}")
    with opened(config, data_dir, make=True) as database:
        _, key = KeyStore(database).add(name, _ROLES[role], timedelta(days=days), shell_entry())
    sys.stdout.write(f"{key}\n")


@people.command("revoke-key")
def revoke_key(name: _Name, config: Config = None, data_dir: DataDir = None) -> None:
    """From now on the key opens nothing; a service that runs knows at once."""
    with opened(config, data_dir) as database:
        revoked = KeyStore(database).revoke(name, shell_entry())
    sys.stdout.write(f"{revoked.name}\n")


@people.command("list")
def list_keys(config: Config = None, data_dir: DataDir = None) -> None:
    """One JSON line a key; `trouble` says why it opens nothing."""
    with opened(config, data_dir) as database:
        for key in KeyStore(database).all():
            told = {**key.model_dump(mode="json"), "role": key.role.word, "trouble": key.trouble(now())}
            sys.stdout.write(f"{json.dumps(told)}\n")
