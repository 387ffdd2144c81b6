"""The command line. stdout carries results only.

Exit codes: 0 done, 2 bad input, 1 any other failure; 1 and 2 come with one line on stderr.
"""

import io
import os
import sys
from importlib.metadata import entry_points, version
from typing import Annotated

import typer

from drivers.errors import BadProfile, DriveError
from service import BadInput, SweepidError
from service.cli.lazy import Commands

GROUP = "sweepid.commands"
_OWN = {
    "demo": "serve:demo",
    "serve": "serve:serve",
    "plan": "campaigns:plan",
    "plan trajectories": "campaigns:plan_trajectories",
    "measure": "campaigns:measure",
    "import": "imports:import_bundle",
    "import trace": "imports:import_trace",
    "check": "identify:check",
    "check sheet": "identify:check_sheet",
    "identify": "identify:identify",
    "diagnose": "identify:diagnose",
    "estimate benefit": "estimate:benefit",
    "estimate payload": "estimate:payload",
    "estimate torque-gain": "estimate:torque_gain",
    "estimate channels": "estimate:channels",
    "report": "report:report",
    "export": "export:export_bundle",
    "export model": "export:export_model",
    "export sheet": "export:export_sheet",
    "export path": "export:export_path",
    "export recording": "export:export_recording",
    "robot check": "robot:check",
    "robot virtual": "robot:virtual",
    "plant fleet": "plant:fleet",
    "plant reidentify": "plant:reidentify",
    "plant jobs": "plant:list_jobs",
    "plant job": "plant:show",
    "plant cancel": "plant:cancel",
    "data backup": "data:backup",
    "data restore": "data:restore",
    "data doctor": "data:doctor",
    "data prune": "data:prune",
    "data hold": "data:hold",
    "data release": "data:release",
    "data holds": "data:holds",
    "data copy": "data:copy",
    "people list": "people:list_people",
    "people add-user": "people:add_user",
    "people change-password": "people:change_password",
    "people disable-user": "people:disable_user",
    "people enable-user": "people:enable_user",
    "people add-key": "people:add_key",
    "people revoke-key": "people:revoke_key",
    "people sessions": "people:sessions",
    "people revoke-session": "people:revoke_session",
    "audit verify": "people:verify_audit",
    "audit export": "people:export_audit",
}
"""By name: module below `service.cli.commands`, and function. A command may be the first word of others."""


def main() -> None:
    """Console script `sweepid`."""
    # before NumPy is imported: our matrices are small, and more threads of its algebra than one only wait for another
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    for stream in (sys.stdout, sys.stderr):  # a letter that the terminal lacks is told as its number
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")
    try:
        if any(name.endswith("_COMPLETE") for name in os.environ):
            from typer.completion import completion_init  # pyright: ignore[reportPrivateImportUsage]

            completion_init()
        build()()
    except (BadInput, BadProfile) as error:
        _leave(2, error)
    except (SweepidError, DriveError) as error:
        _leave(1, error)


def build() -> Commands:
    """The commands: our own and those that installed packages bring by entry point; none is imported yet.

    The name of an entry point is that of the command; `drive.truth` is `sweepid drive truth`.
    """
    # Names of earlier versions. Nothing runs under them: scripts are to be changed once.
    former = {
        **{f"export-{name}": f"export {name}" for name in ("model", "path", "recording", "sheet")},
        **{name: f"estimate {name}" for name in ("benefit", "channels", "payload", "torque-gain")},
        **{name: f"data {name}" for name in ("backup", "doctor", "restore")},
        **{name: f"drive {name}" for name in ("follow", "truth")},
        "check-sheet": "check sheet",
        "db": "data",
        "fleet": "plant fleet",
        "import-trace": "import trace",
        "jobs": "plant jobs",
        "jobs cancel": "plant cancel",
        "jobs reidentify": "plant reidentify",
        "jobs show": "plant job",
        "plan-trajectories": "plan trajectories",
    }
    groups = {
        "audit": "Who asked the service for what.",
        "data": "Back up, restore, examine, prune and copy stored data.",
        "estimate": "Payload, torque constants, delays, and the benefit.",
        "people": "Users and keys for the setting `login: true`.",
        "plant": "Compare many robots; identify stored campaigns again.",
        "robot": "Robots as their manufacturers describe them.",
    }
    places = {name: f"service.cli.commands.{place}" for name, place in _OWN.items()}
    places |= {entry.name.replace(".", " "): entry.value for entry in entry_points(group=GROUP)}
    overview = typer.Typer(add_completion=False)
    overview.callback()(_overview)
    options = typer.main.get_group(overview)
    return Commands(
        places=places, groups=groups, former=former, help=options.help, params=options.params, callback=options.callback
    )


def _tell_version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"sweepid {version('sweepid')}")
        raise typer.Exit


def _tell_completions(shell: str | None) -> None:
    if shell in ("bash", "zsh", "fish"):
        # Typer has no other place from which a program may take it
        from typer.completion import get_completion_script  # pyright: ignore[reportPrivateImportUsage]

        typer.echo(get_completion_script(prog_name="sweepid", complete_var="_SWEEPID_COMPLETE", shell=shell))
        raise typer.Exit
    if shell is not None:
        raise BadInput("--completions", f"unknown shell {shell}: use bash, zsh or fish")


def _overview(
    version: Annotated[
        bool, typer.Option("--version", help="Print the version.", callback=_tell_version, is_eager=True)
    ] = False,
    completions: Annotated[
        str | None,
        typer.Option(
            "--completions",
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
