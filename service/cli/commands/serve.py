"""`sweepid serve`: the process that owns the machine."""

from pathlib import Path
from typing import Annotated

import typer


def serve(
    config: Annotated[Path | None, typer.Option(help="Settings; default: config/service.yaml, if it exists.")] = None,
    host: Annotated[str | None, typer.Option(help="Address to listen at.")] = None,
    port: Annotated[int | None, typer.Option(min=0, max=65535, help="Port to listen at; 0: any free one.")] = None,
    data_dir: Annotated[Path | None, typer.Option(help="Database and recordings.")] = None,
    drive: Annotated[Path | None, typer.Option(help="Drive profile of the machine.")] = None,
    robot: Annotated[str | None, typer.Option(help="Robot of the machine: name of a file of robots_dir.")] = None,
    cell: Annotated[str | None, typer.Option(help="Cell of the machine: name of a file of cells_dir.")] = None,
    no_machine: Annotated[
        bool, typer.Option("--no-machine", help="Own no machine: show the plant of a common database, read only.")
    ] = False,
) -> None:
    """Serve the REST API and the operator's page; prints one JSON line with its address once it is ready."""
    from service.cli.server import run_service
    from service.process.settings import load_settings

    options = {"host": host, "port": port, "data_dir": data_dir, "drive": drive, "robot": robot, "cell": cell}
    given = {name: value for name, value in options.items() if value is not None}
    given |= {"no_machine": True} if no_machine else {}
    run_service(load_settings(config).model_copy(update=given))


def demo(
    out: Annotated[Path, typer.Option(help="Folder for report, bundle, estimate and logs.")] = Path("demo-out"),
    seed: Annotated[
        int | None,
        typer.Option(min=0, help="Of the virtual machines' noise and of what is hidden; else another a run."),
    ] = None,
    poses: Annotated[int, typer.Option(min=1, max=300, help="How many poses to measure.")] = 20,
) -> None:
    """Start a virtual machine and the service, measure a campaign, and show what came of it. Needs no hardware.

    Then the same with a machine that hides an effect: diagnosed first, its truth told afterwards. A wrong name is no
    failure of the demo (exit code 0): it is told as it is.
    """
    from service.cli.demo import show_demo

    show_demo(out, seed, poses)
