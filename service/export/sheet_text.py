"""A sheet as a page for people: which value goes where in which control, and what is left out and why."""

import math

from service.export.load import Array, Load
from service.export.mjcf import quaternion
from service.results.identified.sheet import AxisSheet, Sheet

_NO_LOAD = (
    "Left out. An estimate of the robot tells combinations of the links' parameters, not the mass, centre and inertia "
    "of a body on it. Measure the load with `sweepid payload` and give its file with `--payload`."
)


def as_markdown(sheet: Sheet, load: Load | None = None) -> str:
    """The page; `load`: what was mounted on the last link, where it was measured."""
    parts = [
        f"# Dynamics of {sheet.robot} for its control",
        f"Source: {sheet.source}. Fingerprint: `{sheet.fingerprint}`. All standard deviations include that of "
        "the torque constants.",
        "## What differs from CAD",
        _table(
            ("axis", "CAD", "identified", "± std", "lowest ... highest", "differs by"),
            [
                (
                    axis.joint,
                    _with_unit(axis.cad, axis),
                    _with_unit(axis.identified, axis),
                    _with_unit(axis.std, axis),
                    f"{axis.lowest:.4g} ... {axis.highest:.4g}",
                    f"{100 * (axis.identified / axis.cad - 1):+.1f} %, {axis.differs_in_std:+.1f} std"
                    if axis.cad > 0
                    else "-",
                )
                for axis in sheet.axes
            ],
        ),
        "Medians over the measured poses, the motor included. Between poses the inertia goes from the lowest to the "
        "highest: what takes one value an axis is wrong by as much.",
        _validity(sheet),
        "## Sinumerik",
        _sinumerik(sheet),
        "## Beckhoff",
        _beckhoff(sheet),
        "## KUKA",
        _NO_LOAD if load is None else _kuka(load),
        "## ABB",
        _NO_LOAD if load is None else _abb(load),
        "## ros2_control and MoveIt",
        "Both read the URDF: `sweepid export-model` writes `model.urdf` with these parameters, and the motors' "
        "inertia, for which URDF has no place, into `robot.yaml`.",
    ]
    return "\n\n".join(parts)


def _validity(sheet: Sheet) -> str:
    lines = ["Valid for the robot as it was measured, with everything that was mounted on it then."]
    if sheet.poses is None:
        lines.append("Which poses were measured, the estimate does not tell: make the sheet of the bundle.")
    for joint, ranges in (sheet.poses or {}).items():
        kinds = {axis.joint: axis.kind for axis in sheet.axes}
        told = ", ".join(f"{name} {_position(low, high, kinds.get(name))}" for name, (low, high) in ranges.items())
        lines.append(f"- {joint} was measured with {told}.")
    return "\n".join(lines)


def _position(low: float, high: float, kind: str | None) -> str:
    if kind is None:  # of an axis that was not measured
        return f"{low:.3g} ... {high:.3g} rad (m)"
    factor, unit = (1e3, "mm") if kind == "prismatic" else (math.degrees(1.0), "deg")
    return f"{low * factor:.4g} ... {high * factor:.4g} {unit}"


def _sinumerik(sheet: Sheet) -> str:
    """Values of the axis machine data that torque feed-forward takes."""
    return "\n\n".join(
        [
            "Machine data of the axis `MD32650 $MA_AX_INERTIA`, inertia for torque feed-forward, kg m², on the "
            "motor's side:",
            _inertias(sheet, "MD32650"),
            "It acts with torque feed-forward alone: `MD32620 $MA_FFW_MODE` 2 or 4, `FFWON`. Its balancing (the "
            "equivalent time constants MD32800, MD32810) is left out: it belongs to the current and speed control, not "
            "to the inertia. Compare the unit in your control's list of machine data before you type.",
            *_left_out(sheet),
        ]
    )


def _beckhoff(sheet: Sheet) -> str:
    return "\n\n".join(
        [
            "Total inertia at the motor, kg m². For an AX5000 it is the J_tot of which, with the motor's torque "
            "constant and the amplifier's peak current, `S-0-0348` (acceleration feed-forward gain) is calculated:",
            _inertias(sheet, "J_tot"),
            "The gain itself is left out, because the motor's torque constant is not in the robot file; so is the "
            "object of the load inertia, whose number differs between drives: it takes J_tot less the motor's own "
            "inertia.",
            *_left_out(sheet),
        ]
    )


def _inertias(sheet: Sheet, name: str) -> str:
    """On the motor's side, of every axis that has one."""
    rows = [
        (axis.joint, f"{axis.motor:.5g}", f"{axis.motor_std:.2g}", _span(axis))
        for axis in sheet.axes
        if not axis.left_out
    ]
    return _table(("axis", name, "± std", "lowest ... highest"), rows)


def _kuka(load: Load) -> str:
    a, b, c = _zyx(load.axes)
    return "\n\n".join(
        [
            f"Load data, about the frame of {load.frame} (turn them into the FLANGE frame where that is another):",
            _table(
                ("M kg", "X Y Z mm", "A B C deg", "JX JY JZ kg m²"),
                [
                    (
                        f"{load.mass:.4g} ± {load.mass_std:.2g}",
                        ", ".join(f"{1e3 * value:.4g}" for value in load.centre),
                        ", ".join(f"{value:.4g}" for value in (a, b, c)),
                        ", ".join(f"{value:.4g}" for value in load.moments),
                    )
                ],
            ),
            "For the supplementary loads of A1, A2 and A3 the load must have been on that axis when it was measured; "
            "in which frame they are wanted, the documentation of your controller tells.",
        ]
    )


def _abb(load: Load) -> str:
    cog = ",".join(f"{1e3 * value:.4g}" for value in load.centre)
    aom = ",".join(f"{value:.6f}" for value in quaternion(load.axes))
    inertia = ",".join(f"{value:.4g}" for value in load.moments)
    return "\n\n".join(
        [
            f"`loaddata`, about the frame of {load.frame} (turn it into the tool frame, for `tooldata` into that "
            "of the wrist, where that is another):",
            f"```\nPERS loaddata measured := [{load.mass:.4g},[{cog}],[{aom}],{inertia}];\n```",
            f"Mass ± {load.mass_std:.2g} kg (one standard deviation).",
        ]
    )


def _zyx(rotation: Array) -> tuple[float, float, float]:
    """KUKA's A, B, C, deg: about Z, then the new Y, then the new X."""
    b = math.atan2(-rotation[2, 0], math.hypot(rotation[0, 0], rotation[1, 0]))
    a = math.atan2(rotation[1, 0], rotation[0, 0])
    c = math.atan2(rotation[2, 1], rotation[2, 2])
    return math.degrees(a), math.degrees(b), math.degrees(c)


def _left_out(sheet: Sheet) -> list[str]:
    return [f"Left out: {axis.joint}, {axis.left_out}." for axis in sheet.axes if axis.left_out]


def _span(axis: AxisSheet) -> str:
    return f"{axis.motor_lowest:.4g} ... {axis.motor_highest:.4g}"


def _with_unit(value: float, axis: AxisSheet) -> str:
    return f"{value:.4g} {'kg' if axis.kind == 'prismatic' else 'kg m²'}"


def _table(head: tuple[str, ...], rows: list[tuple[str, ...]]) -> str:
    if not rows:
        return "(no value)"
    lines = [head, tuple("---" for _ in head), *rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)
