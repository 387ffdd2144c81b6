"""`sweepid people`: users, sessions and keys for the setting `login: true`."""

import json
import sys
from datetime import timedelta
from typing import Annotated

import typer

from service.cli.options import Config, DataDir

Name = Annotated[str, typer.Argument(metavar="NAME", help="A person or a program.")]
_ROLES = "viewer, operator, engineer, admin"
_SCOPES = "read, metrics, measure, machine, store, diagnose, audit"


def add_user(
    name: Name,
    role: Annotated[str, typer.Option(help=f"Role of the person: {_ROLES}.")],
    config: Config = None,
    data_dir: DataDir = None,
) -> None:
    """Add a person, with a password: asked for at the terminal, or the first line of stdin."""
    from service.cli.people.arguments import name_of, password_for, role_of
    from service.cli.people.open_database import opened, shell_entry
    from service.store.people.users import UserStore

    name, what = name_of(name), role_of(role)
    with opened(config, data_dir, make=True) as database:
        added = UserStore(database).add(name, what, password_for(name), shell_entry())
    sys.stdout.write(f"{added.name}\n")


def change_password(name: Name, config: Config = None, data_dir: DataDir = None) -> None:
    """Set another password, and end the person's sessions."""
    from service.cli.people.arguments import password_for
    from service.cli.people.open_database import opened, shell_entry
    from service.store.people.users import UserStore

    with opened(config, data_dir) as database:
        changed = UserStore(database).change_password(name, password_for(name), shell_entry())
    sys.stdout.write(f"{changed.name}\n")


def disable_user(name: Name, config: Config = None, data_dir: DataDir = None) -> None:
    """From now on nobody logs in by this name, and its sessions are over."""
    from service.cli.people.open_database import opened, shell_entry
    from service.store.people.users import UserStore

    with opened(config, data_dir) as database:
        disabled = UserStore(database).shut_out(name, shell_entry())
    sys.stdout.write(f"{disabled.name}\n")


def enable_user(name: Name, config: Config = None, data_dir: DataDir = None) -> None:
    """Let one who was disabled log in again, with the same password and role."""
    from service.cli.people.open_database import opened, shell_entry
    from service.store.people.users import UserStore

    with opened(config, data_dir) as database:
        enabled = UserStore(database).let_in(name, shell_entry())
    sys.stdout.write(f"{enabled.name}\n")


def sessions(config: Config = None, data_dir: DataDir = None) -> None:
    """One JSON line a session in which somebody is logged in; `expires_at` moves on with each request."""
    from service.cli.people.open_database import opened, session_store

    with opened(config, data_dir) as database:
        for session in session_store(database, config).all():
            printed = {**session.model_dump(mode="json", exclude={"disabled", "ended_at"}), "role": session.role.word}
            sys.stdout.write(f"{json.dumps(printed)}\n")


def revoke_session(
    number: Annotated[int, typer.Argument(metavar="ID", help="Number from `sweepid people sessions`.")],
    config: Config = None,
    data_dir: DataDir = None,
) -> None:
    """From now on that browser has to log in again."""
    from service.cli.people.open_database import opened, session_store, shell_entry

    with opened(config, data_dir) as database:
        ended = session_store(database, config).end(number, shell_entry())
    sys.stdout.write(f"{ended.id}\n")


def add_key(
    name: Name,
    role: Annotated[str, typer.Option(help=f"Role of the key: {_ROLES}.")],
    days: Annotated[int, typer.Option(min=1, max=3650, help="Days until the key expires.")] = 90,
    scope: Annotated[
        list[str] | None, typer.Option(help=f"Limit the key to this scope; repeatable: {_SCOPES}.")
    ] = None,
    config: Config = None,
    data_dir: DataDir = None,
) -> None:
    """Make a key and print it, once: only its hash is stored. To be sent as `Authorization: Bearer KEY`."""
    from service.cli.people.arguments import name_of, role_of, scopes_of
    from service.cli.people.open_database import opened, shell_entry
    from service.store.people.users import KeyStore

    name, what, scopes = name_of(name), role_of(role), scopes_of(scope or [])
    with opened(config, data_dir, make=True) as database:
        _, key = KeyStore(database).add(name, what, timedelta(days=days), shell_entry(), scopes)
    sys.stdout.write(f"{key}\n")


def revoke_key(name: Name, config: Config = None, data_dir: DataDir = None) -> None:
    """From now on the key opens nothing; a service that runs knows at once."""
    from service.cli.people.open_database import opened, shell_entry
    from service.store.people.users import KeyStore

    with opened(config, data_dir) as database:
        revoked = KeyStore(database).revoke(name, shell_entry())
    sys.stdout.write(f"{revoked.name}\n")


def list_people(config: Config = None, data_dir: DataDir = None) -> None:
    """One JSON line a user and a key; `trouble` says why it opens nothing."""
    from service.cli.people.open_database import opened, print_credential
    from service.store.people.users import KeyStore, UserStore

    with opened(config, data_dir) as database:
        for user in UserStore(database).all():
            print_credential("user", user, user.role, user.trouble)
        keys = KeyStore(database)
        for key in keys.all():
            print_credential("key", key, key.role, key.trouble(keys.now()))
