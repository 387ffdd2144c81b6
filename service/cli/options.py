"""Options that several commands have. Declared without importing what a command computes with."""

from pathlib import Path
from typing import Annotated

import typer

DEFAULT_URL = "http://127.0.0.1:8642"
Url = Annotated[str, typer.Option(envvar="SWEEPID_URL", help="Address of the service.")]
JsonTo = Annotated[str | None, typer.Option("--json", help="Write JSON here; - is stdout.", metavar="FILE")]
Gains = Annotated[Path | None, typer.Option("--torque-gain", help="JSON file of `sweepid estimate torque-gain`.")]
BundleArg = Annotated[Path, typer.Argument(help="Directory of the bundle.", show_default=False)]

# what an export is made of
Source = Annotated[
    Path,
    typer.Argument(
        metavar="BUNDLE|ESTIMATE",
        help="Directory of a bundle, or file of `sweepid identify --json`.",
        show_default=False,
    ),
]
SideFile = Annotated[Path | None, typer.Option("--robot", help="Side file of the robot, for an ESTIMATE.")]

# what plans
RobotFile = Annotated[
    Path | None,
    typer.Argument(help="Side file of the robot, e.g. config/robots/max100-class.yaml; default: that of the machine."),
]
CellName = Annotated[str | None, typer.Option(help="Name of the cell around the robot; default: that of the machine.")]
ConfirmRobot = Annotated[
    str | None, typer.Option(help="Type the name of the robot, if it is another one than the machine's.")
]
ConfirmCell = Annotated[
    str | None, typer.Option(help="Type the name of the cell, if it is another one than the machine's.")
]

# what works on the data of the service
Config = Annotated[Path | None, typer.Option(help="Settings; default: config/service.yaml, if it exists.")]
DataDir = Annotated[Path | None, typer.Option(help="Database and recordings; default: that of the settings.")]
