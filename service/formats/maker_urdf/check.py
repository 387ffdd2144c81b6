"""Unusual and missing data of a manufacturer's URDF, and the URDF with which the service can plan."""

import math
import re
import xml.etree.ElementTree as ET
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import yaml

from service import BadInput
from service.formats.maker_urdf.chain import UrdfFinding, choose_chain
from service.formats.maker_urdf.inertials import (
    POSES,
    check_inertials,
    check_masses,
    embed_hulls,
    link_shapes,
    random_poses,
)
from service.formats.maker_urdf.packages import Packages
from service.model import Array, Axis, Chain, Joint, Most, Robot, RobotDescription, build_robot, read_chain
from service.model.collision import CollisionChecker
from service.model.configuration import Cell
from service.model.urdf import MOST_LINKS, look_over

Pair = tuple[str, str]
CLEARANCE, MARGIN = 0.03, 0.02  # m; rad (m)


@dataclass(frozen=True)
class UrdfCheck:
    """`urdf_text`: one serial chain with all data for planning. `doubted`: links whose inertial is a guess, a
    placeholder, or none of a body.
    """

    name: str
    urdf_text: str
    chain: Chain
    findings: tuple[UrdfFinding, ...]
    gear_ratios: Mapping[str, float | None]  # by joint, of its <transmission>
    doubted: tuple[str, ...]
    lacking: tuple[BadInput, ...]  # meshes and position limits without which nothing is drafted


def check_urdf(text: str, packages: Packages, tip: str | None, place: str) -> UrdfCheck:
    """Check a URDF and extract the chain to `tip` (None: its only one). BadInput if there is no such chain."""
    look_over(text, place)
    root = ET.fromstring(text)
    if root.tag != "robot":
        raise BadInput(place, f"is not a URDF: begins with <{root.tag}>, not <robot>")
    for tag in ("link", "joint"):
        if len(root.findall(tag)) > MOST_LINKS:
            raise BadInput(place, f"has {len(root.findall(tag))} {tag}s, limit {MOST_LINKS}")
    found = choose_chain(root, tip, place)
    limits, lacking = _complete_limits(root, place)
    offs, unread = embed_hulls(root, packages, place)
    found += [*_hidden(root), *limits]
    found += [UrdfFinding("missing", error.place.removeprefix(place).strip(), error.reason) for error in unread]
    if offs:
        worst = max(offs, key=lambda name: offs[name])
        larger = f"The hull of this one is larger than its mesh by up to {1e3 * offs[worst]:.1f} mm, the most of all"
        found.append(UrdfFinding("changed", worst, f"{len(offs)} collision meshes are used as convex hulls. {larger}"))
    inertials, doubted = check_inertials(root, place)
    chain = read_chain(ET.tostring(root, encoding="unicode"), place)
    found += [*inertials, *check_masses(chain, _extent(root, chain.joints[-1].link, place))]
    found += _shapes(root, chain, place)
    for joint in chain.joints:
        found += _limits(joint)
    ratios = {joint.name: _gear_ratio(root, joint.name, place) for joint in chain.joints}
    found += [*_drive_data(chain, ratios), *_dampings(root, chain, place)]
    return UrdfCheck(
        name=root.get("name") or "robot",
        urdf_text=ET.tostring(root, encoding="unicode") + "\n",
        chain=chain,
        findings=tuple(found),
        gear_ratios=ratios,
        doubted=tuple(doubted),
        lacking=(*unread, *lacking),
    )


def _shapes(root: ET.Element, chain: Chain, place: str) -> list[UrdfFinding]:
    reported: list[UrdfFinding] = []
    moving = {joint.link for joint in chain.joints}
    for link in root.findall("link"):
        name = link.get("name", "")
        try:
            shapes = list(link_shapes(link, place))
        except BadInput as error:
            if link.find("collision/geometry/mesh") is None:
                raise
            del error  # a missing mesh was reported before
            continue
        if not shapes and name in moving:
            what = "moves but has no collision shape: its collisions are not detected"
            reported.append(UrdfFinding("unusual", name, what))
        for shape in shapes:
            size = float(np.ptp(shape, axis=0).max())
            if not 0.002 <= size <= 5.0:  # m: outside, a mesh is probably in mm, or scaled twice
                what = f"has a collision shape of {size:.3g} m: is its unit the metre?"
                reported.append(UrdfFinding("unusual", name, what))
    return reported


def _extent(root: ET.Element, link: str, place: str) -> float:
    """Of the shapes of a link from its joint, m."""
    element = next(one for one in root.findall("link") if one.get("name") == link)
    try:
        return max((float(np.linalg.norm(shape, axis=1).max()) for shape in link_shapes(element, place)), default=0.0)
    except BadInput:  # told as missing
        return 0.0


def _hidden(root: ET.Element) -> list[UrdfFinding]:
    hiding = re.compile("counter_?(balance|weight)|balancer|gas_?spring|spring_?(cyl|rod)|parallel|linkage", re.I)
    names = [one.get("name", "") for one in root if one.tag in ("link", "joint")]
    shown = ", ".join(name for name in names if hiding.search(name))
    what = (
        "named like a counterbalance or a parallel linkage, whose force is not in a URDF: sweepid takes it for gravity"
    )
    return [UrdfFinding("unusual", shown, f"{what} and friction of the axis that it acts on")] if shown else []


def _complete_limits(root: ET.Element, place: str) -> tuple[list[UrdfFinding], list[BadInput]]:
    """Give each moving joint limits that are numbers: without velocity or effort limit 0, at which nothing moves.

    Returns what is missing, and errors for positions: the limits of a turn that a check needs are none of a machine.
    """
    found: list[UrdfFinding] = []
    errors: list[BadInput] = []
    for joint in root.findall("joint"):
        name, kind = joint.get("name", ""), joint.get("type")
        if kind == "fixed":
            continue
        limit = joint.find("limit")
        limit = ET.SubElement(joint, "limit") if limit is None else limit
        for key, most in (("velocity", Most.limit), ("effort", Most.effort)):
            text = limit.get(key, "none")
            if not 0 < _float(text) <= most:
                limit.set(key, "0")
                what = f"{key} limit: {text} is not a usable limit; the draft has 0, at which nothing moves"
                found.append(UrdfFinding("missing", name, what))
        low, high = (_float(limit.get(key, "0")) for key in ("lower", "upper"))
        if not -Most.position <= low < high <= Most.position:
            stated = f"{limit.get('lower', 'none')} to {limit.get('upper', 'none')}"
            reason = f"position limits {stated} leave no travel: enter those of the manufacturer in the URDF"
            errors.append(BadInput(f"{place} joint {name}", reason))
            found.append(UrdfFinding("missing", name, reason))
            end = math.pi if kind == "revolute" else 1.0
            limit.set("lower", f"{-end:.6f}")
            limit.set("upper", f"{end:.6f}")
    return found, errors


def _float(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        return math.nan


def _limits(joint: Joint) -> list[UrdfFinding]:
    unit = "m" if joint.kind == "prismatic" else "rad"
    effort = "N" if joint.kind == "prismatic" else "N m"
    reported: list[UrdfFinding] = []
    if joint.soft:
        limits = f"{joint.lower:g} to {joint.upper:g} {unit}"
        what = "the soft limits of <safety_controller> are narrower than <limit> and are used"
        reported.append(UrdfFinding("unusual", joint.name, f"position limits {limits}: {what}"))
    farthest = max(abs(joint.lower), abs(joint.upper))
    if joint.kind == "revolute" and farthest > 4 * math.pi:  # rad: wrists turn up to 7.9
        turns = f"{joint.lower:g} to {joint.upper:g} rad, {farthest / 2 / math.pi:.3g} turns"
        reported.append(UrdfFinding("unusual", joint.name, f"position limits {turns}: is the unit the degree?"))
    for name, value, most, of in (
        ("velocity", joint.velocity, {"revolute": 20.0, "prismatic": 10.0}[joint.kind], f"{unit}/s"),  # rad/s, m/s
        ("effort", joint.effort, 1e5, effort),  # N m, N
    ):
        if value > most:
            what = f"{name} limit {value:g} {of} is not plausible: check its unit"
            reported.append(UrdfFinding("unusual", joint.name, what))
    return reported


def _gear_ratio(root: ET.Element, joint: str, place: str) -> float | None:
    """The reduction of the joint's `<transmission>`; None if there is none, or if it is 1 (used by simulators)."""
    reductions = {
        _number(reduction.text, f"{place} transmission mechanicalReduction")
        for transmission in root.findall("transmission")
        if any(own.get("name") == joint for own in transmission.findall("joint"))
        for reduction in transmission.iter("mechanicalReduction")
    }
    return reductions.pop() if len(reductions) == 1 and not reductions & {0.0, 1.0} else None


def _drive_data(chain: Chain, ratios: Mapping[str, float | None]) -> list[UrdfFinding]:
    """Data that a URDF cannot contain: the user must complete the side file."""
    joints = [joint.name for joint in chain.joints]
    lacking = {
        "gear ratio": [joint for joint in joints if ratios[joint] is None],
        "rated effort: a URDF has only the limit": joints,
        "motor inertia; left open it is found with the load, less well": joints,
        "cogging orders (torque ripple, periods per motor turn); without them J can be ten times less certain": joints,
    }
    return [UrdfFinding("missing", ", ".join(of), what) for what, of in lacking.items() if of]


def _dampings(root: ET.Element, chain: Chain, place: str) -> list[UrdfFinding]:
    """Manufacturers set damping for simulators: a wrong value, as a prior of friction, would cause a wrong J."""
    moving = {joint.name for joint in chain.joints}
    dampings = {
        joint.get("name", ""): _number(dynamics.get("damping"), f"{place} joint {joint.get('name')} damping")
        for joint in root.findall("joint")
        if joint.get("name") in moving
        for dynamics in joint.findall("dynamics")
    }
    shown = ", ".join(f"{joint} {damping:g}" for joint, damping in dampings.items() if damping)
    what = "damping is not used as friction: it is mostly a value for simulators"
    return [UrdfFinding("unusual", shown, what)] if shown else []


def _number(text: str | None, place: str) -> float:
    try:
        value = float(text or "0")
    except ValueError:
        raise BadInput(place, f"{text!r} is not a number") from None
    if not math.isfinite(value):
        raise BadInput(place, f"{text!r} is not finite")
    return value


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


def cell_text(robot: Robot, name: str) -> tuple[str, list[UrdfFinding]]:
    """A cell without obstacles for a robot with all shapes known, and findings that the user should check."""
    nested = _nested(robot)
    pairs = tuple(pair for pair, _ in nested)
    cell = Cell(name=name, clearance=CLEARANCE, joint_margin=MARGIN, ignored_pairs=pairs)
    home, met = _home(robot, CollisionChecker(robot, cell))
    seen = {pair: f"collide in {100 * share:.0f} % of {POSES} poses" for pair, share in nested}
    told = [(pair, f"{words}: treated as nested, not checked") for pair, words in seen.items()]
    told += [(pair, "collide with all joints at 0, or in the middle: home is another pose") for pair in met]
    found = [UrdfFinding("unusual", f"{a}, {b}", sentence) for (a, b), sentence in told]
    lines = [
        f"# Drafted for {name}: without obstacles. Add floor and boxes, m in the robot's base frame.",
        f"name: {_scalar(name)}",
        f"clearance: {CLEARANCE}",
        f"joint_margin: {MARGIN}",
        "boxes: []",
        "ignored_pairs:" if nested else "ignored_pairs: []",
        *(f"  - [{_scalar(a)}, {_scalar(b)}] # {words}" for (a, b), words in seen.items()),
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
    counts = Counter(pair for pose in random_poses(robot.chain) for pair in checker.touching(pose))
    return [(pair, count / POSES) for pair, count in sorted(counts.items()) if count >= 0.9 * POSES]


def _home(robot: Robot, checker: CollisionChecker) -> tuple[Array, Sequence[Pair]]:
    """Home position (n,) and colliding pairs: 0 if a joint's limits leave room for a sweep there, else their middle.

    If there are collisions, the nearest of some random poses with room and without collision.
    """
    joints = robot.chain.joints
    low, high = (np.array([getattr(joint, end) for joint in joints]) for end in ("lower", "upper"))
    room = np.minimum(math.radians(6.0), (high - low) / 4) + MARGIN  # for a sweep, rad (m)
    inside = [joint.lower + own <= 0.0 <= joint.upper - own for joint, own in zip(joints, room, strict=True)]
    home = np.round((low + high) / 2, 4)
    home[inside] = 0.0
    met = sorted(checker.touching(home))
    poses = random_poses(robot.chain, room)
    free = poses[checker.collision_free(poses)] if met else poses[:0]
    if len(free):
        nearest = int(np.argmin(np.linalg.norm(free - home, axis=1)))
        home = free[nearest].round(4)
    return home, met


def _scalar(text: str) -> str:
    """A value in YAML notation, in one line."""
    return yaml.safe_dump(text, width=10_000).removesuffix("...\n").strip()
