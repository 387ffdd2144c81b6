"""Logs of random robots that move all axes at once, computed by Pinocchio and by nothing of the service's dynamics.

Truth: the CAD links deformed by `off`, friction, torque offsets, coloured noise of the torque, and a torque ripple that
the robot file does not name.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import pinocchio as pin
from scipy.signal import lfilter

from service.identification.model.physical_consistency import pseudo_inertia
from service.model import Axis, Prior, Recording, Robot, RobotDescription, Sweep, SweepSpec, build_robot
from tests.random_chain import random_urdf

RATE = 250.0
FINE = 8  # times as fast are springs computed
GRAVITY = (0.0, 0.0, -9.81)
PAYLOAD = np.array([8.0, 0.4, -0.24, 0.64, 0.25, 0.02, 0.22, -0.03, 0.01, 0.18])  # m, mc, I at the last frame


@dataclass(frozen=True)
class Truth:
    """A robot as it is. `links` (n, 10); Jm, Fv, Fc, offset (n,); `noise` and `ripple` N m (N) by joint."""

    robot: Robot
    links: np.ndarray
    motor: np.ndarray
    viscous: np.ndarray
    coulomb: np.ndarray
    offset: np.ndarray
    noise: np.ndarray
    ripple: np.ndarray

    @property
    def parameters(self) -> np.ndarray:
        """(14 n,)"""
        return np.concatenate([self.links.ravel(), self.motor, self.viscous, self.coulomb, self.offset])

    def with_payload(self, payload: np.ndarray) -> "Truth":
        links = self.links.copy()
        links[-1] += payload
        return replace(self, links=links)

    def rigid(self, q: np.ndarray, v: np.ndarray, a: np.ndarray) -> np.ndarray:
        """Efforts (m, n) of links and rotors alone, by Pinocchio."""
        model = pin.buildModelFromXML(self.robot.urdf_text)
        model.gravity.linear = np.array(GRAVITY)
        for k, link in enumerate(self.links):
            model.inertias[k + 1] = pin.Inertia.FromDynamicParameters(link)
        data = model.createData()
        return np.array([pin.rnea(model, data, *x) for x in zip(q, v, a, strict=True)]) + self.motor * a


def draw(seed: int, joints: int, off: float = 0.1, noise: float = 0.004, ripple: float = 0.004) -> Truth:
    """A robot of 3 to 6 axes; `noise` and `ripple` as parts of the rated effort."""
    rng = np.random.default_rng(seed)
    text = random_urdf(rng, joints)
    rated = rng.uniform(400, 1500, joints)
    motor, viscous = rng.uniform(2, 10, joints), rng.uniform(10, 60, joints)
    robot = build_robot(
        RobotDescription(
            name="random",
            urdf="robot.urdf",
            gravity=GRAVITY,
            axes=tuple(
                Axis(
                    joint=f"joint_{k + 1}",
                    gear_ratio=100.0,
                    motor_inertia=motor[k] / 1e4,
                    rated_effort=rated[k],
                    viscous_friction=viscous[k],
                )
                for k in range(joints)
            ),
            prior=Prior(),
        ),
        text,
    )
    return Truth(
        robot=robot,
        links=np.array([_deformed(link, off, rng) for link in robot.chain.inertial]),
        motor=motor * (1 + 0.07 * rng.standard_normal(joints)),
        viscous=viscous * (1 + 0.3 * rng.standard_normal(joints)),
        coulomb=rated * rng.uniform(0.02, 0.08, joints),
        offset=rated * 0.01 * rng.standard_normal(joints),
        noise=noise * rated,
        ripple=ripple * rated,
    )


Path = Callable[[np.ndarray], np.ndarray]


def wander(rng: np.random.Generator, joints: int) -> Path:
    """Sums of sines without a common period; the function gives q, v, a (3, m, n) at times (m,)."""
    frequency = rng.uniform(0.06, 0.55, (joints, 5))
    amplitude = rng.uniform(0.2, 1.0, (joints, 5)) / frequency
    amplitude *= 1.5 / amplitude.sum(axis=1, keepdims=True)
    phase = rng.uniform(0, 2 * np.pi, (joints, 5))
    middle = rng.uniform(-0.6, 0.6, joints)

    def path(time: np.ndarray) -> np.ndarray:
        omega = 2 * np.pi * frequency
        angle = time[:, None, None] * omega + phase
        q = middle + (amplitude * np.sin(angle)).sum(-1)
        v = (amplitude * omega * np.cos(angle)).sum(-1)
        a = -(amplitude * omega**2 * np.sin(angle)).sum(-1)
        return np.array([q, v, a])

    return path


def program(rng: np.random.Generator, joints: int, points: int = 12) -> Path:
    """From point to point with rests between, every axis on a polynomial of degree five."""
    stops = rng.uniform(-1.3, 1.3, (points + 1, joints))
    move, rest = 2.2, 0.5

    def path(time: np.ndarray) -> np.ndarray:
        number = np.minimum((time // (move + rest)).astype(int), points - 1)
        s = np.clip((time - number * (move + rest)) / move, 0, 1)[:, None]
        way = (stops[1:] - stops[:-1])[number]
        q = stops[number] + way * (10 * s**3 - 15 * s**4 + 6 * s**5)
        v = way * (30 * s**2 - 60 * s**3 + 30 * s**4) / move
        a = way * (60 * s - 180 * s**2 + 120 * s**3) / move**2
        return np.array([q, v, a])

    return path


def log(
    truth: Truth,
    path: Path,
    seed: int,
    duration: float = 40.0,
    started_at: float = 0.0,
    block: str = "",
    repeat: int = 0,
    compliance: np.ndarray | None = None,
    encoder: float = 1e-6,
) -> list[Sweep]:
    """What the drives record of all axes, one sweep an axis; with springs of `compliance` (n,) direct encoders as well.

    `encoder`: noise of positions, rad (m). `path` is the load's; the motors are ahead by what the springs give way.
    """
    rng = np.random.default_rng(seed)
    fine = FINE if compliance is not None else 1
    time = np.arange(round(duration * RATE * fine)) / (RATE * fine)
    q, v, a = path(time)
    rigid = truth.rigid(q, v, a)
    motor, speed = q, v
    if compliance is not None:
        links = rigid - truth.motor * a
        motor = q + compliance * links
        speed, gain = (v + np.gradient(compliance * links, time, axis=0), a + _twice(compliance * links, time))
        rigid = links + truth.motor * gain
    friction = truth.viscous * speed + truth.coulomb * np.sign(speed)
    ripple = truth.ripple * np.sin(37.0 * motor + np.arange(q.shape[1]))
    effort = (rigid + friction + truth.offset + ripple)[::fine]
    time, q, v, motor, speed = time[::fine], q[::fine], v[::fine], motor[::fine], speed[::fine]
    effort += _coloured(rng, q.shape) * truth.noise
    position, load = (x + encoder * rng.standard_normal(q.shape) for x in (motor, q))
    return [
        Sweep(
            SweepSpec(
                id=f"{started_at:g}-{joint}",
                axis=joint,
                pose=tuple(motor[0].tolist()),
                offset_velocity=0.0,
                excitation="trajectory",
                sample_rate=RATE,
                started_at=started_at,
                block=block,
                repeat=repeat,
            ),
            Recording(
                time=time,
                effort=effort[:, k],
                velocity=speed[:, k],
                position=position[:, k],
                load_position=None if compliance is None else load[:, k],
            ),
        )
        for k, joint in enumerate(truth.robot.joints)
    ]


def _twice(signal: np.ndarray, time: np.ndarray) -> np.ndarray:
    return np.gradient(np.gradient(signal, time, axis=0), time, axis=0)


def _coloured(rng: np.random.Generator, shape: tuple[int, ...]) -> np.ndarray:
    """White noise and as much power below some Hz, standard deviation 1."""
    slow = lfilter([np.sqrt(1 - 0.95**2)], [1, -0.95], rng.standard_normal(shape), axis=0)
    return (slow + rng.standard_normal(shape)) / np.sqrt(2)


def _deformed(link: np.ndarray, off: float, rng: np.random.Generator) -> np.ndarray:
    """The same body, stretched and sheared: every such body is physical."""
    stretch = np.eye(4) + off * np.diag([1, 1, 1, 0.5]) @ rng.uniform(-1, 1, (4, 4)) @ np.diag([1, 1, 1, 0.3])
    moments = stretch @ pseudo_inertia(link) @ stretch.T
    second = moments[:3, :3]
    tensor = np.trace(second) * np.eye(3) - second
    return np.concatenate([[moments[3, 3]], moments[:3, 3], tensor[[0, 0, 1, 0, 1, 2], [0, 1, 1, 2, 2, 2]]])
