"""`sweepid estimate`: what else sweeps tell: a payload, torque constants, delays, and what the estimate is worth."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, cast

import typer

import sweepid
from service import BadInput
from service.cli.terminal import BundleArg, Gains, JsonTo, counted, put_json, show, waiting

if TYPE_CHECKING:
    from rich.console import Console

    from service.identification.axis.channel_timing import ChannelLags, Lag
    from service.identification.axis.nominal_priors import TorqueGain
    from service.identification.estimates.torque_gain import Calibration, KnownMass
    from service.model import Robot
    from service.report.benefit.benefit import Benefit, ModelBenefit
    from service.store.files.bundle import Bundle
    from sweepid.files import AxisChannels, LagDocument


def channels(
    bundle: BundleArg,
    axis: Annotated[str | None, typer.Option(help="Use the sweeps of this joint only.")] = None,
    json_to: JsonTo = None,
) -> None:
    """Measure how far effort and velocity lag behind position. Prints the lines for the drive profile."""
    from sweepid.files import ChannelTimings

    with waiting("measuring delays"):
        found = measure_channels(sweepid.read_bundle(bundle), axis, str(bundle))
    if put_json(ChannelTimings(axes={joint: as_document(lags) for joint, lags in found.items()}), json_to):
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
    from service.identification.estimates.torque_gain import KnownMass
    from sweepid.files import AxisGain, Gain, TorqueGains

    place, shape = _numbers("--center", center, 3), _numbers("--inertia", inertia, 6)
    body = KnownMass(
        mass, cast(tuple[float, float, float], place), cast(tuple[float, float, float, float, float, float], shape)
    )
    with waiting("comparing the bundles"):
        found = calibrate(sweepid.read_bundle(before), sweepid.read_bundle(after), body, str(after))
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

    with waiting("identifying the payload"):
        found = sweepid.payload(before, after, torque_gain=gains)
    show(found, json_to)


def benefit(
    bundle: BundleArg,
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

    from service.model.configuration import read_robot
    from service.report.benefit.benefit import benefit as benefit_of

    measured = sweepid.read_bundle(bundle)
    cad = measured.robot if robot is None else _same_joints(read_robot(robot), measured.robot, robot)
    with waiting("estimating"):
        found = benefit_of(cad, measured.sweeps, str(bundle))
    if not found.axes:
        why = "; ".join(f"{joint} {reason}" for joint, reason in found.not_judged.items())
        raise BadInput(str(bundle), f"has no axis that can be evaluated: {why}")
    if not put_json(found, json_to):
        print_benefit(found, Console())


def _same_joints(cad: Robot, measured: Robot, path: Path) -> Robot:
    if cad.joints != measured.joints:
        raise BadInput(
            str(path),
            f"has joints {', '.join(cad.joints)}, but the robot of the bundle has {', '.join(measured.joints)}: "
            "give the robot that was measured",
        )
    return cad


def measure_channels(bundle: Bundle, axis: str | None, place: str) -> dict[str, ChannelLags]:
    """By joint, of all axes that were swept or of one; BadInput where there is none."""
    from service.identification.axis.channel_timing import channel_lags

    if axis is not None:
        bundle.robot.index(axis)
    swept = {sweep.spec.axis for sweep in bundle.sweeps if sweep.spec.periodic}
    joints = [joint for joint in bundle.robot.joints if joint in swept and axis in (None, joint)]
    if not joints:
        raise BadInput(place, "has no sweep with sines" if axis is None else f"has no sweep with sines of joint {axis}")
    return {joint: channel_lags(bundle.robot, joint, bundle.sweeps) for joint in counted(joints, "Axes")}


def profile_lines(joint: str, lags: ChannelLags) -> str:
    """YAML of the key `channels` of an axis in the drive profile, with what is known of the numbers as comments."""
    found = f"free resonance {lags.resonance:.3g} Hz" if math.isfinite(lags.resonance) else "no free resonance found"
    lines = [f"# {joint}: {found}", "channels:"]
    for name, lag in (("effort", lags.effort), ("velocity", lags.velocity)):
        apart = "" if lag.apart else ", delay and smoothing together: they cannot be separated"
        lines.append(f"  {name}_delay: {lag.delay:.7f} # s, +- {lag.delay_std:.2g}{apart}")
        smoothing = f" # s, +- {lag.smoothing_std:.2g}" if lag.apart else ""
        lines.append(f"  {name}_smoothing: {lag.smoothing:.7f}{smoothing}")
    return "\n".join(lines)


def as_document(lags: ChannelLags) -> AxisChannels:
    """Of one axis."""
    from sweepid.files import AxisChannels

    return AxisChannels(
        effort=_lag(lags.effort),
        velocity=_lag(lags.velocity),
        free_resonance=lags.resonance if math.isfinite(lags.resonance) else None,
    )


def _lag(lag: Lag) -> LagDocument:
    from service.model.results.estimate import Figure
    from sweepid.files import LagDocument

    return LagDocument(
        delay=Figure(value=lag.delay, std=lag.delay_std),
        smoothing=Figure(value=lag.smoothing, std=lag.smoothing_std),
        total=Figure(value=lag.total, std=lag.total_std),
        apart=lag.apart,
    )


def calibrate(before: Bundle, after: Bundle, mass: KnownMass, place: str) -> dict[str, Calibration]:
    """By joint; BadInput where the bundles are not of one robot or share no pose, or cannot be without and with it."""
    from service.identification.estimates.torque_gain import torque_gains
    from service.identification.spectra.frequency_response import spectrum

    if (before.robot.description, before.robot.urdf_text) != (after.robot.description, after.robot.urdf_text):
        raise BadInput(place, f"is not of robot {before.robot.name} of the first bundle: robot file or URDF differs")
    _check_place(before.robot, mass)
    spectra = [
        [spectrum(bundle.robot, sweep) for sweep in bundle.sweeps if sweep.spec.periodic] for bundle in (before, after)
    ]
    found = torque_gains(before.robot, spectra[0], spectra[1], mass)
    for joint, one in found.items():
        _check_shown(joint, one.gain)
    return found


def _check_place(robot: Robot, mass: KnownMass) -> None:
    """The mass hangs no farther from the last joint than the robot is long."""
    joints = robot.chain.joints
    offsets = sum(math.hypot(*joint.translation) for joint in joints)
    travels = sum(abs(joint.upper - joint.lower) for joint in joints if joint.kind == "prismatic")
    # also a lone axis without a length may carry a mass 1 m out
    longest, away = max(1.0, offsets + travels), math.hypot(*mass.center)
    if away > longest:
        raise BadInput(
            "--center",
            f"is {away:.3g} m from the last joint, limit {longest:.3g} m, the length of the robot's "
            "links: check that the unit is m",
        )


def _check_shown(joint: str, gain: TorqueGain) -> None:
    """A mass that was on, and is what it is said to be, shows, and about as heavy as it is."""
    if not gain.gain > 3 * gain.std:
        raise BadInput(
            joint,
            f"the second campaign shows no added inertia beyond its uncertainty (gain {gain.gain:.3f}, "
            f"standard deviation {gain.std:.3f}): check that the mass was mounted, and its units (kg, "
            "m)",
        )
    if not 0.5 <= gain.gain <= 2.0:  # of a drive whose motor is the one that it was told of
        raise BadInput(
            joint,
            f"the second campaign shows {gain.gain:.3f} times the inertia that the mass adds, and a "
            "gain must be within 0.5 to 2.0: check that this mass was mounted, "
            "and its units (kg, m)",
        )


def print_gains(found: dict[str, Calibration]) -> None:
    """One row an axis."""
    from rich.console import Console
    from rich.table import Table

    table = Table(title="Torque reported by the drive over true torque")
    table.add_column("axis")
    for name in ("gain", "std", "poses", "added inertia, kg m^2"):
        table.add_column(name, justify="right")
    for joint, one in found.items():
        table.add_row(joint, f"{one.gain.gain:.4f}", f"{one.gain.std:.4f}", str(one.poses), f"{one.added:.4g}")
    Console().print(table)


def print_benefit(found: Benefit, console: Console) -> None:
    """Two lines an axis, what was held out, and what is not judged."""
    from rich.box import SIMPLE_HEAD
    from rich.table import Table

    table = Table(title="What the estimate is worth, on held-out sweeps", box=SIMPLE_HEAD, padding=0)
    for name in ("axis", "model"):
        table.add_column(name, overflow="fold")
    for name in ("J off, %", "left at lines", "of it, %", "left in all", "largest", "smallest seen", "force, N"):
        table.add_column(name, justify="right")
    for joint, axis in found.axes.items():
        table.add_row(joint, "CAD", *_figures(axis.cad))
        table.add_row(f"({axis.unit})", "estimate", *_figures(axis.identified), end_section=True)
    console.print(table)
    for joint, axis in found.axes.items():
        held, whole = axis.held_out_poses, axis.poses
        console.print(
            f"{joint}: {len(axis.held_out)} sweeps in {held} of {whole} poses held out (every {found.every}th); "
            f"left at the lines: {_compared(axis.lines_ratio)}; smallest seen: {_compared(axis.smallest_ratio)}.",
            highlight=False,
        )
    for joint, why in found.not_judged.items():
        console.print(f"Not judged: {joint} {why}.", highlight=False)
    console.print(
        "Smallest seen: the smallest external effort that a torque monitor detects with one false alarm in "
        f"{found.quiet_hours:g} h; force: the same at the end of the robot, perpendicular to the lever arm.",
        style="dim",
        highlight=False,
    )


def _compared(ratio: float) -> str:
    """What a value of CAD over that of the estimate means."""
    if abs(ratio - 1) < 0.03:
        return "the same with CAD and estimate"
    return f"{max(ratio, 1 / ratio):.3g} times {'smaller' if ratio > 1 else 'larger'} with the estimate than with CAD"


def _figures(model: ModelBenefit) -> list[str]:
    off = model.inertia_percent
    return [
        f"{off.value:.2f}" if off.std is None else f"{off.value:.2f} ± {off.std:.2f}",
        f"{model.lines_rms:.3g}",
        f"{model.left_percent:.2g}",
        f"{model.effort_rms:.3g}",
        f"{model.effort_peak:.3g}",
        f"{model.smallest_effort:.3g}",
        "–" if model.smallest_force is None else f"{model.smallest_force:.3g}",
    ]
