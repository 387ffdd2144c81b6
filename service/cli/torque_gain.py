"""`sweepid torque-gain BEFORE AFTER`: the torque constants from a known mass, for `sweepid identify --torque-gain`."""

import json
from pathlib import Path
from typing import Annotated, cast

import typer
from rich.console import Console
from rich.table import Table

from service.cli.identify import write_json
from service.errors import BadInput
from service.identification import spectrum
from service.identification.torque_gain import Calibration, KnownMass, torque_gains
from service.store.bundle import Bundle, read_bundle


def torque_gain(
    before: Annotated[Path, typer.Argument(help="Bundle measured without the mass.", show_default=False)],
    after: Annotated[Path, typer.Argument(help="Bundle of the same poses with the mass.", show_default=False)],
    mass: Annotated[float, typer.Option(help="kg", show_default=False)],
    center: Annotated[
        str, typer.Option(help="x,y,z of its centre of mass in the last joint's frame, m", show_default=False)
    ],
    inertia: Annotated[str, typer.Option(help="Ixx,Ixy,Iyy,Ixz,Iyz,Izz about that centre, kg m^2")] = "0,0,0,0,0,0",
    json_to: Annotated[str | None, typer.Option("--json", help="Write JSON here; - is stdout.", metavar="FILE")] = None,
) -> None:
    """Calibrate the torque constant of every axis with a known mass on the last link."""
    place, shape = _numbers("--center", center, 3), _numbers("--inertia", inertia, 6)
    body = KnownMass(
        mass, cast(tuple[float, float, float], place), cast(tuple[float, float, float, float, float, float], shape)
    )
    found = calibrate(read_bundle(before), read_bundle(after), body, str(after))
    axes = {
        joint: {
            "gain": {"value": one.gain.gain, "std": one.gain.std},
            "poses": one.poses,
            "added_inertia": one.added,
        }
        for joint, one in found.items()
    }
    text = json.dumps({"axes": axes}, indent=2, allow_nan=False)
    if json_to == "-":
        typer.echo(text)
        return
    if json_to is not None:
        write_json(Path(json_to), text)
    _print(found)


def calibrate(before: Bundle, after: Bundle, mass: KnownMass, place: str) -> dict[str, Calibration]:
    """By joint; BadInput where the bundles are not of one robot or share no pose."""
    if (before.robot.description, before.robot.urdf_text) != (after.robot.description, after.robot.urdf_text):
        raise BadInput(place, f"was not measured on the same robot {before.robot.name} as the bundle before")
    spectra = [
        [spectrum(bundle.robot, sweep) for sweep in bundle.sweeps if sweep.spec.periodic] for bundle in (before, after)
    ]
    return torque_gains(before.robot, spectra[0], spectra[1], mass)


def _numbers(option: str, text: str, count: int) -> tuple[float, ...]:
    try:
        numbers = tuple(float(part) for part in text.split(","))
    except ValueError:
        numbers = ()
    if len(numbers) != count or not all(abs(number) < float("inf") for number in numbers):
        raise BadInput(option, f"{text!r} is not {count} numbers with commas between")
    return numbers


def _print(found: dict[str, Calibration]) -> None:
    table = Table(title="Torque as the drive tells it over true torque")
    table.add_column("axis")
    for name in ("gain", "std", "poses", "added inertia, kg m^2"):
        table.add_column(name, justify="right")
    for joint, one in found.items():
        table.add_row(joint, f"{one.gain.gain:.4f}", f"{one.gain.std:.4f}", str(one.poses), f"{one.added:.4g}")
    Console().print(table)
