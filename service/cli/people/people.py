"""`sweepid people`: who may use the service from where it listens."""

import json
import sys
from datetime import timedelta
from typing import Annotated

import typer

from service.cli.people.arguments import ROLES, Name, name_of, role_of, scopes_of
from service.cli.people.open_database import Config, DataDir, opened, shell_entry
from service.cli.people.sessions import revoke_session, sessions
from service.cli.people.users import add_user, change_password, disable_user, enable_user
from service.people.permissions import Role
from service.people.scopes import SCOPES
from service.store.people.keys import KeyDocument, KeyStore
from service.store.people.users import UserDocument, UserStore

people = typer.Typer(no_args_is_help=True, rich_markup_mode=None, help="Users and keys for the setting `login: true`.")

people.command("add-user")(add_user)
people.command("change-password")(change_password)
people.command("disable-user")(disable_user)
people.command("enable-user")(enable_user)
people.command("sessions")(sessions)
people.command("revoke-session")(revoke_session)


@people.command("add-key")
def add_key(
    name: Name,
    role: Annotated[str, typer.Option(help=f"Role of the key: {', '.join(ROLES)}.")],
    days: Annotated[int, typer.Option(min=1, max=3650, help="Days until the key expires.")] = 90,
    scope: Annotated[
        list[str] | None, typer.Option(help=f"Limit the key to this scope; repeatable: {', '.join(SCOPES)}.")
    ] = None,
    config: Config = None,
    data_dir: DataDir = None,
) -> None:
    """Make a key and print it, once: only its hash is stored. To be sent as `Authorization: Bearer KEY`."""
    name, what, scopes = name_of(name), role_of(role), scopes_of(scope or [])
    with opened(config, data_dir, make=True) as database:
        _, key = KeyStore(database).add(name, what, timedelta(days=days), shell_entry(), scopes)
    sys.stdout.write(f"{key}\n")


@people.command("revoke-key")
def revoke_key(name: Name, config: Config = None, data_dir: DataDir = None) -> None:
    """From now on the key opens nothing; a service that runs knows at once."""
    with opened(config, data_dir) as database:
        revoked = KeyStore(database).revoke(name, shell_entry())
    sys.stdout.write(f"{revoked.name}\n")


@people.command("list")
def list_people(config: Config = None, data_dir: DataDir = None) -> None:
    """One JSON line a user and a key; `trouble` says why it opens nothing."""
    with opened(config, data_dir) as database:
        for user in UserStore(database).all():
            _tell("user", user, user.role, user.trouble)
        keys = KeyStore(database)
        for key in keys.all():
            _tell("key", key, key.role, key.trouble(keys.now()))


def _tell(kind: str, of: UserDocument | KeyDocument, role: Role, trouble: str) -> None:
    line = {"kind": kind, **of.model_dump(mode="json"), "role": role.word, "trouble": trouble}
    sys.stdout.write(f"{json.dumps(line)}\n")
