"""`sweepid commission draft|check`: an unknown CANopen drive, from its dictionary to a signed sheet."""

import math
import os
import signal
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from drivers.errors import BadProfile

if TYPE_CHECKING:
    from drivers.canopen.profile import CanopenAxis
    from drivers.commission.drive import CheckRow

commission = typer.Typer(no_args_is_help=True, rich_markup_mode=None, help="CANopen drives of other manufacturers.")


@commission.callback()
def _group() -> None:
    """CANopen drives of other manufacturers: draft their files and check their wiring."""


@commission.command()
def draft(
    eds: Annotated[
        Path, typer.Option(help="EDS or DCF of the drive, as its manufacturer's tool wrote it.", show_default=False)
    ],
    out: Annotated[Path, typer.Option(help="Folder for the drafts. Nothing is overwritten.")] = Path(),
    devices: Annotated[Path, typer.Option(help="Folder of the device maps that may fit.")] = Path("config/devices"),
    joint: Annotated[list[str] | None, typer.Option(help="Joint of a drive; several times: nodes 1, 2, ...")] = None,
) -> None:
    """Draft a drive profile, and a device map if none fits. Values that the file does not contain are marked and
    refused.
    """
    from drivers.cia402.profile import FILL_IN
    from drivers.commission.draft import fitting, map_text, profile_text, shortcomings, unfilled
    from drivers.commission.drive import read_dictionary

    dictionary = read_dictionary(eds, 1)
    maps = fitting(dictionary, devices)
    profile, own = out / f"{eds.stem}.yaml", out / f"{eds.stem}-device.yaml"
    device = f"{FILL_IN} one of {', '.join(path.name for path in maps)}"
    texts: dict[Path, str] = {}
    if not maps:
        device, texts[own] = own.name, map_text(dictionary)
    elif len(maps) == 1:
        (one,) = maps
        device = _relative(one, out)
    texts[profile] = profile_text(
        dictionary, joint or ["joint_1"], _relative(eds, out), device, next(iter(maps.values()), None)
    )
    try:
        out.mkdir(parents=True, exist_ok=True)
        for path in texts:
            if path.exists():
                raise BadProfile(f"{path}: exists already; nothing is overwritten")
        for path, text in texts.items():
            path.write_text(text, encoding="utf-8")
            typer.echo(f"{path}: {unfilled(text)} values to fill in")
    except OSError as error:
        raise BadProfile(f"{out}: cannot be written: {error.strerror or error}") from None
    for sentence in () if maps else shortcomings(dictionary):
        typer.echo(f"{eds}: {sentence}", err=True)


@commission.command()
def check(
    profile: Annotated[Path, typer.Argument(help="Drive profile, CANopen.", show_default=False)],
    turn: Annotated[
        list[str] | None,
        typer.Option(help="JOINT=DEGREES (mm): turned by hand during the check; checks gear and sign."),
    ] = None,
    move: Annotated[
        str | None, typer.Option(help="JOINT that is moved a little if every check passes and its name is typed.")
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="One JSON document instead of the table.")] = False,
) -> None:
    """Compare every drive with its profile, without energy except for --move. Exit code 1 if anything differs."""
    from drivers.commission.survey import digests, load, survey
    from drivers.commission.units import named, turned

    machine = load(profile)
    ways = [_way(each) for each in turn or []]
    rows: list[CheckRow] = []
    for joint, way in ways:
        unit = next((axis.unit for axis in machine.axes if axis.joint == joint), "rad")
        instruction = f"Turn {joint} by hand by {way:+g} {'mm' if unit == 'm' else 'degrees'}, then press Enter"
        rows += turned(
            machine,
            joint,
            way * 1e-3 if unit == "m" else math.radians(way),
            lambda instruction=instruction: _entered(instruction),
        )
    axis = None if move is None else named(machine, move)
    sheet = survey(machine, str(profile), digests(profile)).with_rows(rows)
    if axis is not None and not sheet.mismatches:
        _confirmed(axis)
        sheet = sheet.with_rows(_moved(profile, axis), energy=f"with a move of {axis.joint}")
    typer.echo(sheet.json() if as_json else sheet.text())
    if sheet.mismatches:
        raise typer.Exit(1)


def _confirmed(axis: "CanopenAxis") -> None:
    """Raises BadProfile unless the name of the joint is typed."""
    from drivers.commission.moving import motion_text

    typer.echo(f"A person is at the emergency stop. {motion_text(axis)}.", err=True)
    typed = typer.prompt(f"Type {axis.joint} to move it", default="", show_default=False, err=True)
    if typed.strip() != axis.joint:
        raise BadProfile(f"--move: {typed!r} was typed, not {axis.joint}; nothing moved")


def _moved(profile: Path, axis: "CanopenAxis") -> list["CheckRow"]:
    """Every signal that ends a program ends the motion first."""
    import asyncio

    from drivers.commission.moving import moved
    from drivers.registry import open_profile

    numbers = [getattr(signal, name) for name in ("SIGTERM", "SIGHUP") if hasattr(signal, name)]
    before = {number: signal.signal(number, signal.default_int_handler) for number in numbers}
    try:
        return asyncio.run(moved(open_profile(profile)[1], axis))
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _entered(instruction: str) -> None:
    typer.prompt(instruction, default="", show_default=False, err=True)


def _way(option: str) -> tuple[str, float]:
    joint, _, number = option.rpartition("=")
    try:
        way = float(number)
    except ValueError:
        way = math.nan
    if not joint or not (math.isfinite(way) and way):
        raise BadProfile(f"--turn: {option!r} is not JOINT=DEGREES, as joint_1=30, with a number that is not 0")
    return joint, way


def _relative(path: Path, folder: Path) -> str:
    return Path(os.path.relpath(path.resolve(), folder.resolve())).as_posix()
