"""Delay and smoothing of the channels, from calibration sweeps, for the drive profile."""

import math

from service.cli.progress_indicator import counted
from service.identification.axis.channel_timing import ChannelLags, Lag, channel_lags
from service.model.errors import BadInput
from service.model.results.estimate import Figure
from service.model.results.part import Part
from service.store.files.bundle import Bundle


class LagDocument(Part):
    """Of a channel behind position, s; not `apart`: only the total is known."""

    delay: Figure
    smoothing: Figure
    total: Figure
    apart: bool


class AxisChannels(Part):
    """`free_resonance`, Hz, null where none was found."""

    effort: LagDocument
    velocity: LagDocument
    free_resonance: float | None


class Channels(Part):
    """`sweepid estimate channels --json`, by joint."""

    axes: dict[str, AxisChannels]


def measure_channels(bundle: Bundle, axis: str | None, place: str) -> dict[str, ChannelLags]:
    """By joint, of all axes that were swept or of one; BadInput where there is none."""
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
    return AxisChannels(
        effort=_lag(lags.effort),
        velocity=_lag(lags.velocity),
        free_resonance=lags.resonance if math.isfinite(lags.resonance) else None,
    )


def _lag(lag: Lag) -> LagDocument:
    return LagDocument(
        delay=Figure(value=lag.delay, std=lag.delay_std),
        smoothing=Figure(value=lag.smoothing, std=lag.smoothing_std),
        total=Figure(value=lag.total, std=lag.total_std),
        apart=lag.apart,
    )
