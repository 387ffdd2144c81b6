"""The command line. stdout carries results only.

Exit codes: 0 done, 2 bad input, 1 any other failure; 1 and 2 come with one line on stderr.
"""

import os
import sys
from importlib.metadata import entry_points, version
from typing import Annotated

import typer

from drivers.errors import BadProfile, DriveError
from service.cli.lazy import Commands
from service.errors import BadInput, SweepidError

GROUP = "sweepid.commands"
_VERSION = "--version"
_COMPLETIONS = "--completions"
_OWN = {
    "demo": "demo:demo",
    "serve": "serve:serve",
    "backup": "data:backup",
    "restore": "data:restore",
    "doctor": "data:doctor",
    "db copy": "data:copy",
    "db prune": "data:prune",
    "db hold": "data:hold",
    "db release": "data:release",
    "db holds": "data:holds",
    "people add-user": "people:add_user",
    "people change-password": "people:change_password",
    "people disable-user": "people:disable_user",
    "people enable-user": "people:enable_user",
    "people sessions": "people:sessions",
    "people revoke-session": "people:revoke_session",
    "people add-key": "people:add_key",
    "people revoke-key": "people:revoke_key",
    "people list": "people:list_people",
    "audit verify": "audit:verify_audit",
    "audit export": "audit:export_audit",
    "robot check": "robot:check",
    "plan": "plan:plan",
    "plan-trajectories": "plan:plan_trajectories",
    "measure": "measure:measure",
    "import": "imports:import_bundle",
    "export": "export:export_bundle",
    "fleet": "plant:fleet",
    "jobs reidentify": "plant:reidentify",
    "jobs list": "plant:list_jobs",
    "jobs show": "plant:show",
    "jobs cancel": "plant:cancel",
    "report": "report:report",
    "check": "check:check",
    "identify": "identify:identify",
    "diagnose": "diagnose:diagnose",
    "benefit": "estimate:benefit",
    "torque-gain": "estimate:torque_gain",
    "payload": "estimate:payload",
    "channels": "estimate:channels",
    "import-trace": "imports:import_trace",
    "export-model": "export:export_model",
    "export-sheet": "export:export_sheet",
    "check-sheet": "check:check_sheet",
    "export-path": "export:export_path",
    "export-recording": "export:export_recording",
}
"""By name: module below `service.cli.commands`, and function."""
_GROUPS = {
    "audit": "Who asked the service for what.",
    "db": "The database as a whole.",
    "jobs": "Heavy computations over stored campaigns.",
    "people": "Users and keys for the setting `login: true`.",
    "robot": "Robots as their makers describe them.",
}


def main() -> None:
    """Console script `sweepid`."""
    # before NumPy is imported: our matrices are small, and more threads of its algebra than one only wait for another
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    try:
        if any(name.endswith("_COMPLETE") for name in os.environ):
            from service.cli.shell.completions import prepare

            prepare()
        build()()
    except (BadInput, BadProfile) as error:
        _leave(2, error)
    except (SweepidError, DriveError) as error:
        _leave(1, error)


def build() -> Commands:
    """The commands: our own and those that installed packages bring by entry point; none is imported yet."""
    places = {name: f"service.cli.commands.{place}" for name, place in _OWN.items()}
    places |= {entry.name: entry.value for entry in entry_points(group=GROUP)}
    overview = typer.Typer(add_completion=False)
    overview.callback()(_overview)
    options = typer.main.get_group(overview)
    return Commands(places=places, groups=_GROUPS, help=options.help, params=options.params, callback=options.callback)


def _tell_version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"sweepid {version('sweepid')}")
        raise typer.Exit


def _tell_completions(shell: str | None) -> None:
    if shell in ("bash", "zsh", "fish"):
        from service.cli.shell.completions import script

        typer.echo(script(shell))
        raise typer.Exit
    if shell is not None:
        raise BadInput(_COMPLETIONS, f"unknown shell {shell}: use bash, zsh or fish")


def _overview(
    version: Annotated[
        bool, typer.Option(_VERSION, help="Print the version.", callback=_tell_version, is_eager=True)
    ] = False,
    completions: Annotated[
        str | None,
        typer.Option(
            _COMPLETIONS,
            help="Print the completions of a shell: bash, zsh or fish.",
            metavar="SHELL",
            callback=_tell_completions,
            is_eager=True,
            show_default=False,
        ),
    ] = None,
) -> None:
    """Measures the inertia of a robot's axes through its own drives and tells where its model is wrong."""


def _leave(code: int, error: Exception) -> None:
    sys.stderr.write(f"sweepid: {' '.join(str(error).split())}\n")
    raise SystemExit(code)
