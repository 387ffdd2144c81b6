"""A sheet as a page: where to enter each value in each control, and the omitted values with reasons."""

import math

from service.formats.export.files import quaternion
from service.formats.export.sheets.inertias import LoadData, zyx
from service.model.results.part import with_std
from service.model.results.sheet import AxisSheet, Sheet, SheetBody, Supplementary, SupplementaryLoad


def as_markdown(sheet: Sheet, load: LoadData | None = None) -> str:
    """The page; `load`: the payload on the last link, if it was measured."""
    no_load = (
        "Payload: left out. An estimate of the robot contains only combinations of the parameters of its links, "
        "not the mass, centre and inertia of a body on it. Measure the load with `sweepid estimate payload` and "
        "give its file with `--payload`."
    )
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
                    *(f"{size} {_unit(axis)}" for size in _sizes(axis)),
                    " ... ".join(with_std(size, axis.std)[0] for size in (axis.lowest, axis.highest)),
                    f"{100 * (1 - axis.cad / axis.identified):+.1f} %, {axis.differs_in_std:+.1f} std"
                    if axis.cad > 0 and axis.identified > 0
                    else "-",
                )
                for axis in sheet.axes
            ],
        ),
        (
            "Medians over the measured poses, the motor included; differences in percent of the identified. Between "
            "poses the inertia varies from the lowest to the highest value: a single value per axis has this error."
        ),
        _validity(sheet),
        "## Sinumerik",
        _sinumerik(sheet),
        "## Beckhoff",
        _beckhoff(sheet),
        "## KUKA",
        _supplementary(sheet.supplementary),
        no_load if load is None else _kuka(load),
        "## ABB",
        no_load if load is None else _abb(load),
        *([] if load is None else _other_loads(load)),
        "## ros2_control and MoveIt",
        "Both read the URDF: `sweepid export model` writes `model.urdf` with these parameters, and the motors' "
        "inertia, for which URDF has no place, into `robot.yaml`.",
        "## MuJoCo",
        _mujoco(sheet),
    ]
    return "\n\n".join(parts)


def load_page(load: LoadData) -> str:
    """The page of a payload alone."""
    title = f"# Load of {load.mass:.4g} kg for its control"
    return "\n\n".join([title, "## KUKA", _kuka(load), "## ABB", _abb(load), *_other_loads(load)])


def _validity(sheet: Sheet) -> str:
    lines = ["Valid for the robot as it was measured, with everything that was mounted on it then."]
    if sheet.poses is None:
        lines.append("An estimate does not contain the measured poses: make the sheet from the bundle.")
    for joint, ranges in (sheet.poses or {}).items():
        kinds = {axis.joint: axis.kind for axis in sheet.axes} | sheet.kinds
        placed = ", ".join(f"{name} {_position(low, high, kinds.get(name))}" for name, (low, high) in ranges.items())
        lines.append(f"- {joint} was measured with {placed}.")
    return "\n".join(lines)


def _position(low: float, high: float, kind: str | None) -> str:
    if kind is None:  # axis without measurement, in a sheet of an older sweepid
        return f"{low:.3g} ... {high:.3g} rad (m)"
    factor, unit = (1e3, "mm") if kind == "prismatic" else (math.degrees(1.0), "deg")
    first, last = f"{low * factor:.4g}", f"{high * factor:.4g}"
    return f"{first} {unit}" if first == last else f"{first} ... {last} {unit}"


def _sinumerik(sheet: Sheet) -> str:
    """Values of the axis machine data for torque feed-forward."""
    return "\n\n".join(
        [
            "Machine data of the axis `MD32650 $MA_AX_INERTIA`, inertia for torque feed-forward, kg m², on the "
            "motor's side:",
            _inertias(sheet, "MD32650"),
            "It has an effect only with torque feed-forward: `MD32620 $MA_FFW_MODE` 2 or 4, and `FFWON`. The "
            "equivalent time constants (MD32800, MD32810) are left out: they depend on the current and speed "
            "controllers, not on the inertia. Before you type a value, compare its unit with the list of machine data "
            "of your control.",
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
    """On the motor side, of every axis that has one."""
    rows = [
        (axis.joint, *with_std(axis.motor, axis.motor_std), _span(axis)) for axis in sheet.axes if not axis.left_out
    ]
    return _table(("axis", name, "± std", "lowest ... highest"), rows)


def _kuka(load: LoadData) -> str:
    a, b, c = zyx(load.axes)
    return "\n\n".join(
        [
            f"Load data, about the frame of {load.frame} (turn them into the FLANGE frame where that is another):",
            _table(
                ("M kg", "X Y Z mm", "A B C deg", "JX JY JZ kg m²"),
                [
                    (
                        " ± ".join(with_std(load.mass, load.mass_std)),
                        ", ".join(f"{1e3 * value:.4g}" for value in load.centre),
                        ", ".join(f"{value:.4g}" for value in (a, b, c)),
                        ", ".join(f"{value:.4g}" for value in load.moments),
                    )
                ],
            ),
        ]
    )


def _supplementary(found: Supplementary | None) -> str:
    if found is None or not found.loads:
        why = "the sheet was made by an older sweepid" if found is None else found.left_out
        return f"Supplementary loads of A1, A2 and A3: left out, {why}."
    lines = "\n".join(_krl(load) for load in found.loads)
    where = "\n".join(f"- {load.axis}: on {load.link}, in frame {load.frame}." for load in found.loads)
    return "\n\n".join(
        [
            "Supplementary loads, for `$config.dat` (mm, deg, kg, kg m²):",
            f"```\n{lines}\n```",
            where,
            f"Without them CAD differs from the estimate by {found.before:.1f} standard deviations (root mean square "
            f"over the base parameters), with them by {found.after:.1f}. They are the smallest bodies that explain the "
            "difference: the sweeps do not determine every mass. The control computes gravity torques from them too, "
            "so compare the holding torque of A2 and A3 before and after.",
            "Before you enter them, check in the manual of your control (supplementary loads) the frame of each load "
            "and the axis positions at which it is defined: public documents give the frames, but not the axis "
            "positions. If your URDF ends before the mounting face, or its last frame has another orientation than "
            "FLANGE, transform the load of A3.",
        ]
    )


def _krl(load: SupplementaryLoad) -> str:
    x, y, z = (_plain(1e3 * value, 3) for value in load.centre)
    a, b, c = (_plain(value, 4) for value in load.orientation)
    jx, jy, jz = (f"{value:.6g}" for value in load.moments)
    return (
        f"DECL LOAD LOAD_{load.axis}_DATA={{M {load.mass:.6g},CM {{X {x},Y {y},Z {z},A {a},B {b},C {c}}},"
        f"J {{X {jx},Y {jy},Z {jz}}}}}"
    )


def _plain(value: float, digits: int) -> str:
    """At most so many decimals, without an exponent and without -0, because it is typed in by hand."""
    return f"{round(value, digits) + 0.0:.{digits}f}".rstrip("0").rstrip(".")


def _mujoco(sheet: Sheet) -> str:
    if not sheet.bodies:
        return "Left out: the sheet was made by an older sweepid."
    lines = "\n".join(line for body in sheet.bodies for line in _mjcf(body))
    return "\n\n".join(
        [
            "One physical robot with the identified base parameters, for the `body` and `joint` of each name (a whole "
            "model: `sweepid export model`, `model.xml`):",
            f"```xml\n{lines}\n```",
        ]
    )


def _mjcf(body: SheetBody) -> tuple[str, str, str]:
    centre = " ".join(f"{value:.8g}" for value in body.centre)
    inertia = " ".join(f"{value:.8g}" for value in body.inertia)
    return (
        f"<!-- body {body.link}, joint {body.joint} -->",
        f'<inertial pos="{centre}" mass="{body.mass:.8g}" fullinertia="{inertia}"/>',
        f'<joint name="{body.joint}" armature="{body.armature:.8g}" damping="{body.damping or 0.0:.8g}"/>',
    )


def _abb(load: LoadData) -> str:
    cog = ",".join(f"{1e3 * value:.4g}" for value in load.centre)
    aom = ",".join(f"{value:.6f}" for value in quaternion(load.axes))
    inertia = ",".join(f"{value:.4g}" for value in load.moments)
    return "\n\n".join(
        [
            f"`loaddata`, about the frame of {load.frame} (turn it into the tool frame, for `tooldata` into that "
            "of the wrist, where that is another):",
            f"```\nPERS loaddata measured := [{load.mass:.4g},[{cog}],[{aom}],{inertia}];\n```",
            f"Mass {' ± '.join(with_std(load.mass, load.mass_std))} kg (one standard deviation).",
        ]
    )


def _other_loads(load: LoadData) -> list[str]:
    """Of the controls that take a load in the axes of the flange, which are taken to be those of `load.frame`.

    UR: Script manual, `set_target_payload`. Franka: `franka_msgs/SetLoad`, libfranka `setLoad`. FANUC: screen
    MOTION/PAYLOAD SET, 1 kg m^2 = 100 / 9.80665 kgf cm s^2. Yaskawa: manual of the DX200, 8.4 ARM control.
    """
    (xx, xy, xz), (_, yy, yz), (_, _, zz) = load.tensor.tolist()
    x, y, z = load.centre
    mass = f"{load.mass:.4g}"
    metres, diagonal, products = _listed(x, y, z), (xx, yy, zz), _listed(xy, xz, yz)
    where = f"About the frame of {load.frame}: turn centre and inertia into the axes of the flange where these differ."
    loose = f"Left out, no field: the products of inertia ({products} kg m²)."
    too_large = max(abs(value) for value in (*diagonal, xy, xz, yz)) > 133
    return [
        "## Universal Robots",
        where,
        f"```\nset_target_payload({mass}, [{metres}], [{_listed(*diagonal, xy, xz, yz)}])\n```",
        "kg, m, kg m² (Ixx, Iyy, Izz, Ixy, Ixz, Iyz about the centre; a product is minus the integral of x y)."
        + (" It refuses more than 133 kg m²: this load has more." if too_large else ""),
        "## Franka",
        where,
        f"```\nset_load: mass {mass}, center_of_mass [{metres}], "
        f"load_inertia [{_listed(xx, xy, xz, xy, yy, yz, xz, yz, zz)}]\n```",
        "kg, m, kg m² by columns. It does not take the end effector: that is set in Desk, and both are added.",
        "## FANUC",
        where,
        _table(
            ("PAYLOAD kg", "PAYLOAD CENTER X Y Z cm", "PAYLOAD INERTIA X Y Z kgf cm s²"),
            [(mass, _listed(*(100 * value for value in load.centre)), _listed(*(100 / 9.80665 * i for i in diagonal)))],
        ),
        f"MOTION/PAYLOAD SET; Z points out of the faceplate. {loose} Inertia about the centre.",
        "## Yaskawa",
        where,
        _table(
            ("W kg", "Xg Yg Zg mm", "Ix Iy Iz kg m²"),
            [(mass, _listed(*(1e3 * value for value in load.centre)), _listed(*diagonal))],
        ),
        f"Tool file, axes of the flange, inertia about the centre. {loose}",
        "## Sinumerik, the load",
        "Left out: an axis has no field for mass and centre. `MD32650` takes the load only as inertia of the axis: "
        "measure the axes with the load on, and make this sheet of that bundle.",
    ]


def _listed(*values: float) -> str:
    return ", ".join(f"{value + 0.0:.4g}" for value in values)


def _left_out(sheet: Sheet) -> list[str]:
    return [f"Left out: {axis.joint}, {axis.left_out}." for axis in sheet.axes if axis.left_out]


def _span(axis: AxisSheet) -> str:
    return f"{axis.motor_lowest:.4g} ... {axis.motor_highest:.4g}"


def _sizes(axis: AxisSheet) -> tuple[str, str, str]:
    """CAD, identified, standard deviation."""
    return with_std(axis.cad, axis.std)[0], *with_std(axis.identified, axis.std)


def _unit(axis: AxisSheet) -> str:
    return "kg" if axis.kind == "prismatic" else "kg m²"


def _table(head: tuple[str, ...], rows: list[tuple[str, ...]]) -> str:
    if not rows:
        return "(no value)"
    lines = [head, tuple("---" for _ in head), *rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)
