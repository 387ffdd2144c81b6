"""`sweepid estimate`: what else sweeps tell: a payload, torque constants, delays, and what the estimate is worth."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, cast

import typer

import sweepid
from service.cli.options import Bundle, Gains, JsonTo
from service.model.errors import BadInput

if TYPE_CHECKING:
    from service.model.robot import Robot


def channels(
    bundle: Bundle,
    axis: Annotated[str | None, typer.Option(help="Use the sweeps of this joint only.")] = None,
    json_to: JsonTo = None,
) -> None:
    """Measure how far effort and velocity lag behind position. Prints the lines for the drive profile."""
    from service.cli.documents import put_json
    from service.cli.progress_indicator import waiting
    from service.cli.recordings.channels import Channels, as_document, measure_channels, profile_lines
    from service.store.files.bundle import read_bundle

    with waiting("measuring delays"):
        found = measure_channels(read_bundle(bundle), axis, str(bundle))
    if put_json(Channels(axes={joint: as_document(lags) for joint, lags in found.items()}), json_to):
        return
    for joint, lags in found.items():
        typer.echo(profile_lines(joint, lags))


def torque_gain(
    before: Annotated[Path, typer.Argument(help="Bundle measured without the mass.", show_default=False)],
    after: Annotated[Path, typer.Argument(help="Bundle of the same poses with the mass.", show_default=False)],
    mass: Annotated[float, typer.Option(help="kg", show_default=False)],
    center: Annotated[
        str, typer.Option(help="x,y,z of its centre of mass in the last joint's frame, m", show_default=False)
    ],
    inertia: Annotated[str, typer.Option(help="Ixx,Ixy,Iyy,Ixz,Iyz,Izz about that centre, kg m^2")] = "0,0,0,0,0,0",
    json_to: JsonTo = None,
) -> None:
    """Calibrate the torque constant of every axis with a known mass on the last link."""
    from service.cli.documents import put_json
    from service.cli.progress_indicator import waiting
    from service.cli.recordings.torque_gain import calibrate, print_gains
    from service.identification.estimates.torque_gain import KnownMass
    from service.store.files.bundle import read_bundle
    from sweepid.files import AxisGain, Gain, TorqueGains

    place, shape = _numbers("--center", center, 3), _numbers("--inertia", inertia, 6)
    body = KnownMass(
        mass, cast(tuple[float, float, float], place), cast(tuple[float, float, float, float, float, float], shape)
    )
    with waiting("comparing the bundles"):
        found = calibrate(read_bundle(before), read_bundle(after), body, str(after))
    axes = {
        joint: AxisGain(gain=Gain(value=one.gain.gain, std=one.gain.std), poses=one.poses, added_inertia=one.added)
        for joint, one in found.items()
    }
    if put_json(TorqueGains(axes=axes), json_to):
        return
    print_gains(found)


def _numbers(option: str, text: str, count: int) -> tuple[float, ...]:
    try:
        numbers = tuple(float(part) for part in text.split(","))
    except ValueError:
        numbers = ()
    if len(numbers) != count or not all(abs(number) < float("inf") for number in numbers):
        raise BadInput(option, f"{text!r} is not {count} numbers separated by commas")
    return numbers


def payload(
    before: Annotated[Path, typer.Argument(help="Bundle measured without the payload.", show_default=False)],
    after: Annotated[Path, typer.Argument(help="Bundle of the same motions with it.", show_default=False)],
    gains: Gains = None,
    json_to: JsonTo = None,
) -> None:
    """Identify a payload on the last link from the same motions with and without it."""
    from service.cli.documents import put_json
    from service.cli.progress_indicator import waiting

    with waiting("identifying the payload"):
        found = sweepid.payload(before, after, torque_gain=gains)
    if not put_json(found, json_to):
        from service.cli.tables import print_result

        print_result(found)


def benefit(
    bundle: Bundle,
    robot: Annotated[
        Path | None,
        typer.Option(
            help="CAD model to compare with: side file (YAML) next to its URDF. Default: that of the bundle.",
            metavar="FILE",
        ),
    ] = None,
    json_to: JsonTo = None,
) -> None:
    """Predict the drive torque of held-out sweeps by CAD and by an estimate of the other sweeps."""
    from rich.console import Console

    from service.cli.benefit.table import print_benefit
    from service.cli.documents import put_json
    from service.cli.progress_indicator import waiting
    from service.model.configuration import read_robot
    from service.report.benefit import benefit as benefit_of
    from service.store.files.bundle import read_bundle

    measured = read_bundle(bundle)
    cad = measured.robot if robot is None else _same_joints(read_robot(robot), measured.robot, robot)
    with waiting("estimating"):
        found = benefit_of(cad, measured.sweeps, str(bundle))
    if not found.axes:
        why = "; ".join(f"{joint} {reason}" for joint, reason in found.not_judged.items())
        raise BadInput(str(bundle), f"has no axis that can be evaluated: {why}")
    if not put_json(found, json_to):
        print_benefit(found, Console())


def _same_joints(cad: "Robot", measured: "Robot", path: Path) -> "Robot":
    if cad.joints != measured.joints:
        raise BadInput(
            str(path),
            f"has joints {', '.join(cad.joints)}, but the robot of the bundle has {', '.join(measured.joints)}: "
            "give the robot that was measured",
        )
    return cad
