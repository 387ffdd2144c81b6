"""`sweepid people`: those that log in with a password."""

import sys
from typing import Annotated

import typer

from service.cli.people.arguments import ROLES, Name, name_of, password_for, role_of
from service.cli.people.open_database import Config, DataDir, opened, shell_entry
from service.store.people.users import UserStore


def add_user(
    name: Name,
    role: Annotated[str, typer.Option(help=f"Role of the person: {', '.join(ROLES)}.")],
    config: Config = None,
    data_dir: DataDir = None,
) -> None:
    """Add a person, with a password: asked for at the terminal, or the first line of stdin."""
    name, what = name_of(name), role_of(role)
    with opened(config, data_dir, make=True) as database:
        added = UserStore(database).add(name, what, password_for(name), shell_entry())
    sys.stdout.write(f"{added.name}\n")


def change_password(name: Name, config: Config = None, data_dir: DataDir = None) -> None:
    """Set another password, and end the person's sessions."""
    with opened(config, data_dir) as database:
        changed = UserStore(database).change_password(name, password_for(name), shell_entry())
    sys.stdout.write(f"{changed.name}\n")


def disable_user(name: Name, config: Config = None, data_dir: DataDir = None) -> None:
    """From now on nobody logs in by this name, and its sessions are over."""
    with opened(config, data_dir) as database:
        disabled = UserStore(database).shut_out(name, shell_entry())
    sys.stdout.write(f"{disabled.name}\n")


def enable_user(name: Name, config: Config = None, data_dir: DataDir = None) -> None:
    """Let one who was disabled log in again, with the same password and role."""
    with opened(config, data_dir) as database:
        enabled = UserStore(database).let_in(name, shell_entry())
    sys.stdout.write(f"{enabled.name}\n")
