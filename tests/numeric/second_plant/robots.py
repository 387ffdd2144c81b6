"""Robots at random: arms of 3 to 6 axes, arms on a track, SCARA, gantries and tilting tables, as CAD and as built.

A body is held by its mass, centre and second moment about the centre, S = integral r r' dm (Wensing, Kim, Slotine,
"Linear matrix inequalities for physically consistent inertial parameter identification", 2018): any positive S is a
body that can exist, so a CAD model may be put off by any factors without leaving physics. I = tr(S) 1 - S.
"""

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Random = np.random.Generator


@dataclass(frozen=True)
class Body:
    """A rigid body in its link's frame: kg, m, kg m^2."""

    mass: float
    centre: Array  # (3,)
    spread: Array  # (3, 3), second moment about the centre

    @property
    def inertia(self) -> Array:
        """About the centre, (3, 3)."""
        return np.trace(self.spread) * np.eye(3) - self.spread


@dataclass(frozen=True)
class Joint:
    """A moving joint, no rotation between its frame and the one before; limits in rad (m)."""

    kind: Literal["revolute", "prismatic"]
    origin: tuple[float, float, float]
    axis: tuple[float, float, float]
    lower: float
    upper: float


@dataclass(frozen=True)
class Mechanism:
    """A serial chain; the flange is a point of the last link. `linked` is a joint whose next one is driven through a
    parallelogram from before both, so that its link keeps its direction while the joint alone turns.
    """

    name: str
    joints: tuple[Joint, ...]
    bodies: tuple[Body, ...]
    flange: Array  # (3,)
    linked: int | None = None

    @property
    def coupling(self) -> Array:
        """(n, n): positions of the joints by those of the drives."""
        matrix = np.eye(len(self.joints))
        if self.linked is not None:
            same = float(np.dot(self.joints[self.linked].axis, self.joints[self.linked + 1].axis))
            matrix[self.linked + 1, self.linked] = -same
        return matrix

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(f"joint_{k + 1}" for k in range(len(self.joints)))


def block(mass: float, centre: tuple[float, float, float], size: tuple[float, float, float], random: Random) -> Body:
    """A box of even density with its axes a little turned, as no casting is symmetric."""
    turn, _ = np.linalg.qr(np.eye(3) + 0.12 * random.normal(size=(3, 3)))
    spread = turn @ np.diag(np.square(size) / 12.0 * mass) @ turn.T
    return Body(mass, np.array(centre) + 0.02 * random.normal(size=3), spread)


def joined(one: Body, other: Body) -> Body:
    """Both as one."""
    mass = one.mass + other.mass
    centre = (one.mass * one.centre + other.mass * other.centre) / mass
    arms = [(body.mass, body.centre - centre) for body in (one, other)]
    return Body(mass, centre, one.spread + other.spread + sum(m * np.outer(arm, arm) for m, arm in arms))


def put_off(cad: Mechanism, low: float, high: float, random: Random) -> Mechanism:
    """As built: every mass, every component of a centre, every principal inertia off by `low` to `high`, either way."""

    def factors(count: int) -> Array:
        return 1.0 + random.choice([-1.0, 1.0], count) * random.uniform(low, high, count)

    def other(body: Body) -> Body:
        stretch = np.diag(np.sqrt(factors(3)))
        mass = body.mass * float(factors(1)[0])
        return Body(mass, body.centre * factors(3), stretch @ body.spread @ stretch)

    return replace(cad, bodies=tuple(other(body) for body in cad.bodies))


def urdf(mechanism: Mechanism) -> str:
    """As text; links without shapes."""
    parts = [f'<robot name="{mechanism.name}">', '  <link name="base_link"/>']
    for number, (joint, body) in enumerate(zip(mechanism.joints, mechanism.bodies, strict=True), 1):
        tensor = body.inertia
        entries = {"ixx": (0, 0), "ixy": (0, 1), "ixz": (0, 2), "iyy": (1, 1), "iyz": (1, 2), "izz": (2, 2)}
        inertia = " ".join(f'{key}="{float(tensor[place])!r}"' for key, place in entries.items())
        parent = f"link_{number - 1}" if number > 1 else "base_link"
        parts += [
            f'  <link name="link_{number}">',
            f'    <inertial><origin xyz="{_text(body.centre)}" rpy="0 0 0"/><mass value="{body.mass!r}"/>',
            f"      <inertia {inertia}/></inertial>",
            "  </link>",
            f'  <joint name="joint_{number}" type="{joint.kind}">',
            f'    <parent link="{parent}"/><child link="link_{number}"/>',
            f'    <origin xyz="{_text(joint.origin)}" rpy="0 0 0"/><axis xyz="{_text(joint.axis)}"/>',
            f'    <limit lower="{joint.lower!r}" upper="{joint.upper!r}" effort="1000000.0" velocity="3.0"/>',
            "  </joint>",
        ]
    parts += [
        '  <link name="tool0"/>',
        '  <joint name="flange" type="fixed">',
        f'    <parent link="link_{len(mechanism.joints)}"/><child link="tool0"/>',
        f'    <origin xyz="{_text(mechanism.flange)}" rpy="0 0 0"/>',
        "  </joint>",
        "</robot>",
    ]
    return "\n".join(parts) + "\n"


def random_mechanism(random: Random, name: str, family: str) -> Mechanism:
    """A robot of a family; SI."""
    joints, bodies, flange = _FAMILIES[family](random)
    turned = tuple(_turned(joint, random) for joint in joints)
    return Mechanism(name, turned, tuple(bodies), np.array(flange))


Parts = tuple[list[Joint], list[Body], tuple[float, float, float]]


def _arm(random: Random, axes: int | None = None) -> Parts:
    axes = int(random.integers(3, 7)) if axes is None else axes
    scale = random.uniform(0.75, 1.15)
    offset, upper, fore = (scale * random.uniform(*span) for span in ((0.1, 0.4), (0.8, 1.2), (0.9, 1.4)))
    joints = [
        Joint("revolute", (0.0, 0.0, random.uniform(0.3, 0.6)), (0, 0, 1), -3.1, 3.1),
        Joint("revolute", (offset, 0.0, random.uniform(0.2, 0.35)), (0, 1, 0), -1.7, 1.5),
        Joint("revolute", (0.0, 0.0, upper), (0, 1, 0), -2.4, 2.4),
    ]
    bodies = [
        block(scale**3 * random.uniform(200, 380), (offset / 3, 0.02, 0.12), (0.5, 0.45, 0.5), random),
        block(scale**3 * random.uniform(110, 230), (0.02, -0.06, 0.42 * upper), (0.28, 0.25, 1.1 * upper), random),
        block(scale**3 * random.uniform(90, 190), (0.3 * fore, 0.03, 0.06), (0.8 * fore, 0.25, 0.28), random),
    ]
    wrist = [
        (Joint("revolute", (0.55 * fore, 0.0, 0.1), (1, 0, 0), -2.8, 2.8), (30, 60), (0.12, 0.01, 0), (0.4, 0.2, 0.2)),
        (Joint("revolute", (0.4 * fore, 0.0, 0.0), (0, 1, 0), -1.9, 1.9), (15, 35), (0.06, 0, 0.01), (0.2, 0.16, 0.16)),
        (Joint("revolute", (0.15, 0.0, 0.0), (1, 0, 0), -3.0, 3.0), (8, 20), (0.05, 0.0, 0.01), (0.12, 0.15, 0.15)),
    ]
    for joint, mass, centre, size in wrist[: axes - 3]:
        joints.append(joint)
        bodies.append(block(scale**3 * random.uniform(*mass), centre, size, random))
    return joints, bodies, (0.2, 0.0, 0.0) if axes > 3 else (fore, 0.0, 0.0)


def _on_track(random: Random) -> Parts:
    joints, bodies, flange = _arm(random, int(random.integers(3, 6)))
    track = Joint("prismatic", (0.0, 0.0, 0.3), (1, 0, 0), -1.5, 1.5)
    return [track, *joints], [block(random.uniform(200, 500), (0, 0, 0.1), (1.0, 0.8, 0.2), random), *bodies], flange


def _scara(random: Random) -> Parts:
    inner, outer = random.uniform(0.6, 0.9), random.uniform(0.5, 0.8)
    joints = [
        Joint("revolute", (0.0, 0.0, 0.6), (0, 0, 1), -2.6, 2.6),
        Joint("revolute", (inner, 0.0, 0.1), (0, 0, 1), -2.4, 2.4),
        Joint("prismatic", (outer, 0.0, 0.0), (0, 0, 1), -0.6, 0.6),
        Joint("revolute", (0.0, 0.0, -0.3), (0, 0, 1), -3.0, 3.0),
    ]
    bodies = [
        block(random.uniform(80, 200), (0.45 * inner, 0.03, 0.05), (inner, 0.3, 0.25), random),
        block(random.uniform(70, 150), (0.5 * outer, 0.02, 0.1), (outer, 0.3, 0.3), random),
        block(random.uniform(40, 90), (0.03, 0.02, -0.1), (0.15, 0.15, 0.9), random),
        block(random.uniform(15, 40), (0.05, 0.03, -0.1), (0.2, 0.2, 0.2), random),
    ]
    return joints, bodies, (0.0, 0.0, -0.2)


def _gantry(random: Random) -> Parts:
    joints = [
        Joint("prismatic", (0.0, 0.0, 2.0), (1, 0, 0), -1.5, 1.5),
        Joint("prismatic", (0.0, 0.1, 0.2), (0, 1, 0), -1.2, 1.2),
        Joint("prismatic", (0.1, 0.0, 0.0), (0, 0, 1), -0.8, 0.8),
        Joint("revolute", (0.0, 0.0, -0.6), (0, 0, 1), -3.0, 3.0),
        Joint("revolute", (0.0, 0.0, -0.3), (0, 1, 0), -1.8, 1.8),
    ][: int(random.integers(3, 6))]
    bodies = [
        block(random.uniform(300, 700), (0.0, 0.1, 0.0), (0.6, 3.0, 0.5), random),
        block(random.uniform(150, 300), (0.05, 0.0, 0.1), (0.6, 0.6, 0.6), random),
        block(random.uniform(90, 200), (0.0, 0.05, -0.2), (0.25, 0.25, 1.6), random),
        block(random.uniform(40, 90), (0.08, 0.04, -0.15), (0.6, 0.4, 0.4), random),
        block(random.uniform(30, 70), (0.05, 0.02, -0.2), (0.3, 0.3, 0.5), random),
    ][: len(joints)]
    return joints, bodies, (0.0, 0.0, -0.4)


def _table(random: Random) -> Parts:
    """A slide that carries a trunnion with a round table."""
    joints = [
        Joint("prismatic", (0.0, 0.0, 0.5), (1, 0, 0), -1.2, 1.2),
        Joint("revolute", (0.1, 0.0, 0.4), (0, 1, 0), -1.9, 1.9),
        Joint("revolute", (0.05, 0.0, random.uniform(0.1, 0.2)), (0, 0, 1), -3.1, 3.1),
    ]
    bodies = [
        block(random.uniform(400, 800), (0.0, 0.0, 0.0), (1.2, 1.4, 0.4), random),
        block(random.uniform(250, 450), (0.05, 0.02, random.uniform(0.05, 0.15)), (0.6, 1.2, 0.4), random),
        block(random.uniform(250, 450), (0.06, 0.05, 0.1), (1.0, 1.0, 0.3), random),
    ]
    return joints, bodies, (0.0, 0.0, 0.3)


def _turned(joint: Joint, random: Random) -> Joint:
    """Every third axis counts the other way."""
    if random.random() < 2 / 3:
        return joint
    x, y, z = joint.axis
    return replace(joint, axis=(-x, -y, -z), lower=-joint.upper, upper=-joint.lower)


def _text(vector: object) -> str:
    return " ".join(f"{float(x)!r}" for x in np.asarray(vector, dtype=float))


_FAMILIES = {"arm": _arm, "track": _on_track, "scara": _scara, "gantry": _gantry, "table": _table}
FAMILIES = tuple(_FAMILIES)
