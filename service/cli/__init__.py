"""The command line. stdout carries results only.

Exit codes: 0 done, 2 bad input, 1 any other failure; 1 and 2 come with one line on stderr.
"""

import gc
import os
import sys
from importlib.metadata import EntryPoint, entry_points, version
from typing import Annotated

import typer

from drivers.errors import BadProfile, DriveError
from service.errors import BadInput, SweepidError

GROUP = "sweepid.commands"
_VERSION = "--version"
_COMPLETIONS = "--completions"
_OWN = (
    ("demo", "service.cli.demo:demo"),
    ("serve", "service.cli.serve:serve"),
    ("backup", "service.cli.backup:backup"),
    ("restore", "service.cli.restore:restore"),
    ("doctor", "service.cli.doctor:doctor"),
    ("db", "service.cli.database.copy:db"),
    ("people", "service.cli.people.people:people"),
    ("audit", "service.cli.people.audit:audit"),
    ("robot", "service.cli.robot:robot"),
    ("plan", "service.cli.campaign.plan:plan"),
    ("plan-trajectories", "service.cli.campaign.plan_trajectories:plan_trajectories"),
    ("measure", "service.cli.campaign.measure:measure"),
    ("import", "service.cli.campaign.import_bundle:import_bundle"),
    ("export", "service.cli.campaign.export_bundle:export_bundle"),
    ("fleet", "service.cli.plant.fleet:fleet"),
    ("jobs", "service.cli.plant.jobs:jobs"),
    ("report", "service.cli.campaign.report:report"),
    ("check", "service.cli.recordings.check:check"),
    ("identify", "service.cli.recordings.identify:identify"),
    ("diagnose", "service.cli.recordings.diagnose:diagnose"),
    ("benefit", "service.cli.benefit.benefit:benefit"),
    ("torque-gain", "service.cli.recordings.torque_gain:torque_gain"),
    ("payload", "service.cli.recordings.payload:payload_command"),
    ("channels", "service.cli.recordings.channels:channels"),
    ("import-trace", "service.cli.recordings.import_trace:import_trace"),
    ("export-model", "service.cli.exports.export_model:export_model"),
    ("export-sheet", "service.cli.exports.export_sheet:export_sheet"),
    ("check-sheet", "service.cli.exports.check_sheet:check_sheet"),
    ("export-path", "service.cli.exports.export_path:export_path"),
    ("export-recording", "service.cli.exports.export_recording:export_recording"),
)


def main() -> None:
    """Console script `sweepid`."""
    # before NumPy is imported: our matrices are small, and more threads of its algebra than one only wait for another
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    try:
        words = _asked()
        (_loaded(sys.argv[1:]) if words is None else _loaded(words, only_names=not words))()
    except (BadInput, BadProfile) as error:
        _leave(2, error)
    except (SweepidError, DriveError) as error:
        _leave(1, error)


def _loaded(arguments: list[str], only_names: bool = False) -> typer.Typer:
    """`build` without garbage collection: modules live until the end, and each collection would scan all of them."""
    before = gc.get_threshold()
    gc.set_threshold(0)
    try:
        return build(arguments, only_names)
    finally:
        gc.set_threshold(*before)


def build(arguments: list[str], only_names: bool = False) -> typer.Typer:
    """The commands: our own and those that installed packages bring by entry point.

    Only the one that is called is loaded (`plan` needs no simulator); all for the overview, none for the version.
    `only_names`: none is loaded, a shell wants to know which there are.
    """
    application = typer.Typer(
        add_completion=False, no_args_is_help=True, rich_markup_mode=None, pretty_exceptions_enable=False
    )
    application.callback()(_overview)
    entries = {name: EntryPoint(name, value, GROUP) for name, value in _OWN}
    entries |= {entry.name: entry for entry in entry_points(group=GROUP)}
    called = next((name for name in arguments[:1] if name in (*entries, _VERSION, _COMPLETIONS)), None)
    for name, entry in entries.items():
        if only_names:
            application.command(name)(_overview)
        elif called in (None, name):
            command: object = entry.load()
            if isinstance(command, typer.Typer):  # a group of commands
                application.add_typer(command, name=name)
            else:
                application.command(name)(entry.load())
    return application


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


def _asked() -> list[str] | None:
    """The words of a line that a shell wants to complete."""
    if not any(name.endswith("_COMPLETE") for name in os.environ):
        return None
    from service.cli.shell.completions import asked

    return asked()


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
