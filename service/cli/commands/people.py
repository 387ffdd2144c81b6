"""`sweepid people`: users, sessions and keys for the setting `login: true`."""

from __future__ import annotations

import getpass
import json
import sys
from collections.abc import Generator
from contextlib import contextmanager
from datetime import timedelta
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from service import BadInput
from service.cli.terminal import Config, DataDir, shell_entry, write_file

if TYPE_CHECKING:
    from service.store.access import Role
    from service.store.people.audit import Entry
    from service.store.people.users import KeyStore, UserStore

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
    name, what = name_of(name), role_of(role)
    with _people(config, data_dir, make=True) as (users, _, entry):
        typer.echo(users.add(name, what, password_for(name), entry).name)


def change_password(name: Name, config: Config = None, data_dir: DataDir = None) -> None:
    """Set another password, and end the person's sessions."""
    with _people(config, data_dir) as (users, _, entry):
        typer.echo(users.change_password(name, password_for(name), entry).name)


def disable_user(name: Name, config: Config = None, data_dir: DataDir = None) -> None:
    """From now on nobody logs in by this name, and its sessions are over."""
    with _people(config, data_dir) as (users, _, entry):
        typer.echo(users.set_enabled(name, entry, enabled=False).name)


def enable_user(name: Name, config: Config = None, data_dir: DataDir = None) -> None:
    """Let one who was disabled log in again, with the same password and role."""
    with _people(config, data_dir) as (users, _, entry):
        typer.echo(users.set_enabled(name, entry).name)


@contextmanager
def _people(
    config: Path | None, data_dir: Path | None, make: bool = False
) -> Generator[tuple[UserStore, KeyStore, Entry]]:
    """Users and keys, and the entry of the audit for the person at the terminal."""
    from service.cli.database import opened
    from service.store.people.users import KeyStore, UserStore

    with opened(config, data_dir, make) as database:
        yield UserStore(database), KeyStore(database), shell_entry()


def sessions(config: Config = None, data_dir: DataDir = None) -> None:
    """One JSON line a session in which somebody is logged in; `expires_at` moves on with each request."""
    from service.cli.database import opened, session_store

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
    from service.cli.database import opened, session_store

    with opened(config, data_dir) as database:
        typer.echo(session_store(database, config).end(number, shell_entry()).id)


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
    name, what, scopes = name_of(name), role_of(role), scopes_of(scope or [])
    with _people(config, data_dir, make=True) as (_, keys, entry):
        _, key = keys.add(name, what, timedelta(days=days), entry, scopes)
    sys.stdout.write(f"{key}\n")


def revoke_key(name: Name, config: Config = None, data_dir: DataDir = None) -> None:
    """From now on the key opens nothing; a service that runs knows at once."""
    with _people(config, data_dir) as (_, keys, entry):
        typer.echo(keys.revoke(name, entry).name)


def list_people(config: Config = None, data_dir: DataDir = None) -> None:
    """One JSON line a user and a key; `trouble` says why it opens nothing."""
    from service.cli.database import print_credential

    with _people(config, data_dir) as (users, keys, _):
        for user in users.all():
            print_credential("user", user, user.role, user.trouble)
        for key in keys.all():
            print_credential("key", key, key.role, key.trouble(keys.now()))


def name_of(given: str) -> str:
    """A name that may be given. BadInput."""
    from service.store.access import LONGEST_NAME, is_name

    name = given.strip()
    if not is_name(name):
        raise BadInput("NAME", f"{name[:LONGEST_NAME]!r} is not a name: 1 to {LONGEST_NAME} printable characters")
    return name


def role_of(word: str) -> Role:
    """BadInput."""
    from service.store.access import Role

    roles = {role.word: role for role in Role}
    if word not in roles:
        raise BadInput("--role", f"{word!r} is not one of {', '.join(roles)}")
    return roles[word]


def scopes_of(words: list[str]) -> tuple[str, ...] | None:
    """None where there are none: all that the role may. BadInput."""
    from service.store.access import SCOPES

    for word in words:
        if word not in SCOPES:
            raise BadInput("--scope", f"{word!r} is not one of {', '.join(SCOPES)}")
    return tuple(dict.fromkeys(words)) or None


def password_for(name: str) -> str:
    """Asked for twice at a terminal, else the first line of stdin: no argument, which every process can read."""
    if not sys.stdin.isatty():
        return sys.stdin.readline().removesuffix("\n")
    password = getpass.getpass(f"Password of {name}: ")
    if getpass.getpass("Once more: ") != password:
        raise BadInput("password", "the two passwords differ; nothing was changed")
    return password


def verify_audit(
    head: Annotated[
        str | None,
        typer.Option(
            metavar="NUMBER:SHA256|FILE",
            help="Output of an earlier run, or a file with heads (or a log). Default: the file of the service.",
        ),
    ] = None,
    config: Config = None,
    data_dir: DataDir = None,
) -> None:
    """Does each entry fit the one before it, and are all known heads in the chain? Prints the head as NUMBER:SHA256, or
    the first entry that does not fit.
    """
    from service.cli.database import audit_heads_file, opened
    from service.store.people.audit import AuditStore, heads_in, read_head, verify

    file = Path(head) if head is not None else audit_heads_file(config, data_dir)
    if file.is_file():
        expected = heads_in(file.read_text("utf-8", errors="replace"), str(file))
    elif head is not None:
        expected = (read_head(head),)
    else:
        expected = ()
    with opened(config, data_dir) as database:
        number, value = verify(AuditStore(database).links(), expected)
    if not expected:
        sys.stderr.write(f"no head is known ({file} does not exist): an end that was cut off would not be noticed\n")
    sys.stdout.write(f"{number}:{value}\n")


def export_audit(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="JSON lines to write.")],
    config: Config = None,
    data_dir: DataDir = None,
) -> None:
    """Write all entries as JSON lines; `entry` is the text whose hash `sha256` goes over. Prints the file."""
    from service.cli.database import opened
    from service.store.people.audit import AuditStore

    with opened(config, data_dir) as database:
        lines = [
            json.dumps({"number": number, "entry": entry, "sha256": value})
            for number, entry, value in AuditStore(database).links()
        ]
    write_file(file, "\n".join(lines))
    sys.stdout.write(f"{file}\n")
