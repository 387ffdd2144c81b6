"""The demo on the terminal: its progress, and what was found."""

import math
import secrets
import signal
from pathlib import Path

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, SpinnerColumn, TaskID, TextColumn
from rich.table import Table

from service.cli.demo.hidden import Found, plain
from service.cli.demo.run import Outcome, run_demo
from service.cli.demo.screen import Screen
from service.cli.tables import print_result
from service.diagnosis.summary import judged_on
from service.model.errors import SweepidError
from service.report.benefit import sentence
from service.web.client import Json

SEEDS = 1_000_000


class Interrupted(SweepidError):
    """A person pressed Ctrl-C: the machine was stopped, all processes were ended."""


def show_demo(out: Path, seed: int | None, poses: int) -> None:
    """Run the demo with its progress on stderr, and print what was found. `seed` None: a random one."""
    seed = secrets.randbelow(SEEDS) if seed is None else seed
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    words = Console(stderr=True)
    columns = (
        SpinnerColumn(),
        TextColumn("{task.description}"),
        BarColumn(bar_width=30),
        MofNCompleteColumn(),
        TextColumn("{task.fields[detail]}"),
    )
    try:
        with Progress(*columns, console=words) as bars:
            outcome = run_demo(out, seed, poses, _screen(bars, bars.add_task("", total=None, detail="")))
    except KeyboardInterrupt:
        raise Interrupted("interrupted; the machine was stopped and all processes have ended") from None
    console = Console()
    _print_estimate(outcome, console)
    _print_diagnosis(outcome.found, console)
    _print_worth(outcome, console)
    console.print(f"Report: {outcome.report}", soft_wrap=True, highlight=False)
    console.print(f"Bundle: {outcome.bundle}  (sweepid identify {outcome.bundle})", soft_wrap=True, highlight=False)
    console.print(f"The same again: --seed {seed}", highlight=False)


def _screen(bars: Progress, bar: TaskID) -> Screen:
    def progress(campaign: Json) -> None:
        done = campaign["progress"]
        detail = _detail(campaign)
        bars.update(bar, total=done["total"], completed=done["done"], detail=detail)

    def doing(what: str) -> None:
        bars.update(bar, description=what, detail="")

    def say(note: str) -> None:
        bars.console.print(note, style="yellow", highlight=False)

    return Screen(doing, progress, say)


def _detail(campaign: Json) -> str:
    """Remaining time, axis and pose."""
    current, remaining = campaign["progress"]["current"], campaign["progress"]["remaining"]
    if current is None:
        return "identifying the last sweeps" if campaign["state"] == "measured" else ""
    pose = ", ".join(f"{math.degrees(position):.0f}°" for position in current["spec"]["pose"])
    left = "" if remaining is None else f"{int(remaining // 60)}:{int(remaining % 60):02d} left, "
    return f"{left}{current['spec']['axis']} at ({pose})"


def _print_estimate(outcome: Outcome, console: Console) -> None:
    print_result(outcome.content.estimate, console)
    table = Table(title="Errors against the truth in percent: median (95th percentile)")
    table.add_column("")
    for joint in outcome.content.truth_columns:
        table.add_column(joint, justify="right")
    for row in outcome.content.truth:
        table.add_row(row.label, *row.figures)
    console.print(table)


def _print_worth(outcome: Outcome, console: Console) -> None:
    console.print("\n[bold]What you gain[/bold]", highlight=False)
    if outcome.worth.axes:
        console.print(sentence(outcome.worth), highlight=False)
    for joint, why in outcome.worth.not_judged.items():
        console.print(f"Not judged: {joint} {why}.", highlight=False)


def _print_diagnosis(found: Found, console: Console) -> None:
    axis = found.axis
    gap, floor = axis.gap, axis.gap.noise_floor_rms
    asked = f" after {', '.join(map(plain, found.experiments))}" if found.experiments else ""
    console.print(f"\n[bold]A machine that hides something in {found.joint}[/bold]", highlight=False)
    console.print(f"Found{asked}: {axis.summary}", highlight=False)
    console.print(
        f"Gap {judged_on(gap.model_dump())}: {gap.before_rms:.3g} N m before, "
        f"{gap.after_rms:.3g} N m after, noise floor {'–' if floor is None else f'{floor:.3g} N m'}.",
        highlight=False,
    )
    console.print(f"Hidden: {found.description}.", highlight=False)
    console.print(f"[bold]{found.judgement}[/bold]", highlight=False)
