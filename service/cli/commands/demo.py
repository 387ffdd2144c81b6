"""`sweepid demo`: measure, identify, diagnose and report a virtual robot, end to end, with the real parts."""

from pathlib import Path
from typing import Annotated

import typer


def demo(
    out: Annotated[Path, typer.Option(help="Folder for report, bundle, estimate and logs.")] = Path("demo-out"),
    seed: Annotated[
        int | None,
        typer.Option(min=0, help="Of the virtual machines' noise and of what is hidden; else another a run."),
    ] = None,
    poses: Annotated[int, typer.Option(min=1, max=300, help="How many poses to measure.")] = 24,
) -> None:
    """Start a virtual machine and the service, measure a campaign, and show what came of it. Needs no hardware.

    Then the same with a machine that hides an effect: diagnosed first, its truth told afterwards. A wrong name is no
    failure of the demo (exit code 0): it is told as it is.
    """
    from service.cli.demo.command import show_demo

    show_demo(out, seed, poses)
