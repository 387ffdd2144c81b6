"""Drafts that the user completes: the robot's side file, and a cell without collisions at rest."""

import math
from collections import Counter
from collections.abc import Sequence

import numpy as np
import yaml
from numpy.typing import NDArray

from service.formats.maker_urdf.check import UrdfCheck
from service.formats.maker_urdf.finding import Finding
from service.model.collision import CollisionChecker
from service.model.configuration import Cell
from service.model.robot import Axis, Robot, RobotDescription, build_robot

Array = NDArray[np.float64]

Pair = tuple[str, str]

CLEARANCE, MARGIN = 0.03, 0.02  # m; rad (m)
ROOM = math.radians(6.0)  # for a sweep, rad (m)
POSES = 200  # random poses to find shapes that overlap by construction
NESTED = 0.9  # fraction of them in which two shapes overlap


def side_file_text(check: UrdfCheck, name: str, urdf: str) -> str:
    """The side file (`config/robots/*.yaml`) of a robot with the data of its URDF; null where data are missing."""
    lines = [
        ("# Drafted from a maker's URDF. Complete the values that are null from the data sheets of motors and gears:"),
        "# gear_ratio: motor revolutions per joint revolution (prismatic: motor rad per m), signed; must be completed",
        "# rated_effort: what motor and gear can give continuously, at the joint; has to be completed",
        ("# motor_inertia: kg m^2 on the motor side, brake included; null: unknown, it is measured with the load"),
        "# viscous_friction: N m s/rad (N s/m) at the joint; null: unknown",
        "# cogging_orders: torque ripple, periods per motor revolution, from the motor's maker; [] if unknown.",
        "#   A ripple that is not given here counts as noise, and J can be ten times less certain",
        "# transmission_orders: gear error, periods per motor revolution, from the gear's maker; [] if unknown",
        f"name: {_scalar(name)}",
        f"urdf: {_scalar(urdf)}",
        "gravity: [0.0, 0.0, -9.81] # in the base frame: turn it for a robot that hangs",
        "axes:",
    ]
    for joint in check.chain.joints:
        given, unit = check.gear_ratios[joint.name], "N" if joint.kind == "prismatic" else "N m"
        ratio = "null" if given is None else f"{given!r} # of the URDF's <transmission>"
        lines += [
            f"  - joint: {_scalar(joint.name)}",
            f"    gear_ratio: {ratio}",
            "    motor_inertia: null",
            f"    rated_effort: null # the URDF's limit is {joint.effort:g} {unit}",
            "    viscous_friction: null",
            "    cogging_orders: []",
            "    transmission_orders: []",
        ]
    lines.append("prior: # how far the model may be off: one sigma, relative")
    if check.doubted:
        lines.append(f"  # the inertials of {', '.join(check.doubted)} are guesses, placeholders or not possible")
    spread = 1.0 if check.doubted else 0.3
    lines += [f"  inertia: {spread}", f"  gravity: {spread}"]
    lines += ["  viscous_friction: 0.5", "  motor_inertia: 0.1", "  effort_gain: 0.05"]
    return "\n".join(lines) + "\n"


def cell_text(robot: Robot, name: str) -> tuple[str, list[Finding]]:
    """A cell without obstacles for a robot with all shapes known, and findings that the user should check."""
    nested = _nested(robot)
    pairs = tuple(pair for pair, _ in nested)
    cell = Cell(name=name, clearance=CLEARANCE, joint_margin=MARGIN, ignored_pairs=pairs)
    home, met = _home(robot, CollisionChecker(robot, cell))
    found = [
        Finding(
            "unusual", f"{a}, {b}", f"collide in {100 * share:.0f} % of {POSES} poses: treated as nested, not checked"
        )
        for (a, b), share in nested
    ]
    found += [
        Finding("unusual", f"{a}, {b}", "collide with all joints at 0, or in the middle: home is another pose")
        for a, b in met
    ]
    lines = [
        f"# Drafted for {name}: without obstacles. Add floor and boxes, m in the robot's base frame.",
        f"name: {_scalar(name)}",
        f"clearance: {CLEARANCE}",
        f"joint_margin: {MARGIN}",
        "boxes: []",
        "ignored_pairs:" if nested else "ignored_pairs: []",
        *(
            f"  - [{_scalar(a)}, {_scalar(b)}] # collide in {100 * share:.0f} % of {POSES} poses"
            for (a, b), share in nested
        ),
        "home:" if home.any() else "home: {}",
        *(f"  {_scalar(joint)}: {at:.4f}" for joint, at in zip(robot.joints, home, strict=True) if at),
    ]
    return "\n".join(lines) + "\n", found


def bare_robot(check: UrdfCheck) -> Robot:
    """The chain with an arbitrary drive train, which collision checks do not use."""
    axes = tuple(Axis(joint=joint.name, gear_ratio=1.0, rated_effort=1.0) for joint in check.chain.joints)
    return build_robot(RobotDescription(name=check.name, urdf="", axes=axes), check.urdf_text)


def _nested(robot: Robot) -> Sequence[tuple[Pair, float]]:
    """Pairs of links that overlap in nearly all poses, with the fraction of the poses."""
    checker = CollisionChecker(robot, Cell(name="none", clearance=CLEARANCE))
    counts = Counter(pair for pose in _drawn(robot, np.zeros(len(robot.joints))) for pair in checker.touching(pose))
    return [(pair, count / POSES) for pair, count in sorted(counts.items()) if count >= NESTED * POSES]


def _home(robot: Robot, checker: CollisionChecker) -> tuple[Array, Sequence[Pair]]:
    """Home position (n,) and colliding pairs: 0 if a joint's limits leave room for a sweep there, else their middle.

    If there are collisions, the nearest of some random poses with room and without collision.
    """
    joints = robot.chain.joints
    low, high = _ends(robot)
    room = np.minimum(ROOM, (high - low) / 4) + MARGIN
    inside = [joint.lower + own <= 0.0 <= joint.upper - own for joint, own in zip(joints, room, strict=True)]
    home = np.round((low + high) / 2, 4)
    home[inside] = 0.0
    met = sorted(checker.touching(home))
    poses = _drawn(robot, room)
    free = poses[checker.collision_free(poses)] if met else poses[:0]
    if len(free):
        nearest = int(np.argmin(np.linalg.norm(free - home, axis=1)))
        home = free[nearest].round(4)
    return home, met


def _drawn(robot: Robot, room: Array) -> Array:
    """Poses (m, n) at least `room` (n,) from the limits, reproducible."""
    low, high = _ends(robot)
    return np.random.default_rng(1).uniform(low + room, high - room, (POSES, len(low)))


def _ends(robot: Robot) -> tuple[Array, Array]:
    joints = robot.chain.joints
    return np.array([joint.lower for joint in joints]), np.array([joint.upper for joint in joints])


def _scalar(text: str) -> str:
    """A value in YAML notation, in one line."""
    return yaml.safe_dump(text, width=10_000).removesuffix("...\n").strip()
