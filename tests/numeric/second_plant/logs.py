"""Logs of whole robots with known truth, as drives record them: MuJoCo's inverse dynamics, springs, friction that
sticks, and the plant's sensors. Every seed is another robot, another kind of motion and another robot file.
"""

from dataclasses import dataclass, replace

import mujoco
import numpy as np
from numpy.typing import NDArray

from service.model import Axis, Prior, Recording, Robot, RobotDescription, Sweep, SweepSpec, build_robot
from tests.numeric.second_plant.bodies import Rigid
from tests.numeric.second_plant.friction import Bristle, Now
from tests.numeric.second_plant.robots import Body, Mechanism, joined, put_off, random_mechanism, urdf
from tests.numeric.second_plant.sensors import Sensors, noise

Array = NDArray[np.float64]
Random = np.random.Generator

FINE = 1000.0  # Hz, at which friction and springs are computed
REACH = 1e-4  # rad (m), way on which dry friction yields


@dataclass(frozen=True)
class Kind:
    """What a log is of; drawn from a seed."""

    family: str
    small: bool  # an arm of 30 kg, wrists with rotors 20 to 550 times as heavy as what they turn
    rate: float
    duration: float
    motion: str  # wander, program, single
    elastic: bool
    encoders: bool
    unknown_rotors: bool
    wall: bool  # gravity along x
    rough: bool  # 25 % Stribeck friction and a ripple of 0.5 % of the largest effort
    payload: float = 0.0  # of the mass of the first link, on the last one and unknown to CAD
    balance: float = 0.0  # of the largest torque of the second axis, by a spring unknown to CAD


@dataclass(frozen=True)
class Log:
    """The robot file, one log to identify from, another of the same kind to predict, and the truth, SI."""

    kind: Kind
    robot: Robot
    sweeps: tuple[Sweep, ...]
    held_out: tuple[Sweep, ...]
    links: Array  # (n, 10)
    rotors: Array  # (n,) on the joint side
    viscous: Array
    coulomb: Array

    def inertia(self, poses: Array) -> Array:
        """About every axis with the others held, and the rotor, (m, n)."""
        rigid = Rigid(self._built)
        return np.array([np.diag(rigid.matrix(pose)) for pose in poses]) + self.rotors

    def holding(self, poses: Array) -> Array:
        """Torques that hold poses (m, n), with the spring of the counterbalance."""
        rigid, held = Rigid(self._built, self._gravity), np.zeros_like(poses)
        held[:, 1] = -self._spring * np.sin(poses[:, 1])
        return held + np.array([rigid.holding(pose) for pose in poses])

    _built: Mechanism
    _gravity: tuple[float, float, float]
    _spring: float


def kind_of(seed: int) -> Kind:
    """Everything that a seed decides but the numbers."""
    random = np.random.default_rng([30, seed])
    elastic = random.random() < 0.5
    return Kind(
        family=("arm", "arm", "arm", "table")[seed % 4],
        small=bool(random.random() < 0.5),
        rate=float(random.choice([50.0, 100.0, 125.0, 250.0])),
        duration=float(random.choice([11.0, 20.0, 30.0, 40.0])),
        motion=("program", "wander", "single")[seed % 3],
        elastic=elastic,
        encoders=elastic and random.random() < 0.5,
        unknown_rotors=bool(random.random() < 0.7),
        wall=bool(random.random() < 0.3),
        rough=bool(random.random() < 0.5),
    )


def log(seed: int, **fixed: object) -> Log:
    """A log; `fixed` overrides what the seed decides."""
    kind = replace(kind_of(seed), **fixed)  # type: ignore[arg-type]
    random = np.random.default_rng([31, seed])
    cad = random_mechanism(random, "robot", kind.family)
    cad = _scaled(cad, 0.5, 0.05) if kind.small else cad
    built = put_off(cad, 0.10, 0.18, random)
    gravity = (-9.81, 0.0, 0.0) if kind.wall else (0.0, 0.0, -9.81)
    bare = Rigid(built, gravity)
    if kind.payload:
        mass, last = kind.payload * cad.bodies[0].mass, built.bodies[-1]
        body = Body(mass, built.flange, mass * np.diag([0.01, 0.02, 0.03]) * (0.25 if kind.small else 1.0))
        built = replace(built, bodies=(*built.bodies[:-1], joined(last, body)))
    rigid = Rigid(built, gravity)
    count = len(cad.joints)
    middle = np.mean([(j.lower, j.upper) for j in cad.joints], axis=1)
    own = np.array([np.diag(bare.matrix(pose)) for pose in middle + random.uniform(-1, 1, (20, count))]).mean(axis=0)
    rotors = own * random.uniform(0.2, 1.0, count)
    wrists = slice(3, None)
    rotors[wrists] = own[wrists] * np.exp(random.uniform(*np.log((20, 550) if kind.small else (2, 40)), count))[wrists]
    paths = [_path(kind, cad, random) for _ in range(2)]
    torques, motors = zip(*(_torques(kind, rigid, path, own, random) for path in paths), strict=True)
    spring = kind.balance * float(np.abs(torques[0][:, 1]).max())
    for torque, path in zip(torques, paths, strict=True):
        torque[:, 1] -= spring * np.sin(path[:, 1])
    unloaded = _inverse(bare, paths[0]) if kind.payload else torques[0]
    weights = np.sqrt(np.mean(unloaded**2, axis=0)) + rotors * 2.0
    coulomb, viscous = weights * random.uniform(0.1, 0.4, count), weights * random.uniform(0.05, 0.3, count)
    offset = 0.02 * weights * random.standard_normal(count)
    drives = (rotors, viscous, coulomb, offset)
    noises = random
    if kind.payload:  # recorded hours later
        drives, noises = (rotors, 0.93 * viscous, 1.04 * coulomb, 1.1 * offset), np.random.default_rng([32, seed])
    records = [
        _recorded(kind, cad, drives, run, path, torque, motor, weights, noises)
        for run, (path, torque, motor) in enumerate(zip(paths, torques, motors, strict=True))
    ]
    known = not kind.unknown_rotors
    rated = weights * random.uniform(1.5, 4.0, count)
    axes = tuple(
        Axis(
            joint=name,
            gear_ratio=100.0,
            motor_inertia=float(rotors[k] * random.uniform(0.93, 1.07) / 1e4) if known else None,
            rated_effort=float(rated[k]),
            viscous_friction=float(viscous[k] * random.uniform(0.7, 1.3)) if known else None,
        )
        for k, name in enumerate(cad.names)
    )
    described = RobotDescription(name="log", urdf="robot.urdf", gravity=gravity, axes=axes, prior=Prior())
    links = np.array([_ten(body) for body in built.bodies])
    return Log(
        kind, build_robot(described, urdf(cad)), *records, links, rotors, viscous, coulomb, built, gravity, spring
    )


def _scaled(cad: Mechanism, length: float, mass: float) -> Mechanism:
    joints = tuple(
        replace(j, origin=tuple(length * x for x in j.origin),
                **({"lower": length * j.lower, "upper": length * j.upper} if j.kind == "prismatic" else {}))
        for j in cad.joints
    )  # fmt: skip
    bodies = tuple(Body(mass * b.mass, length * b.centre, mass * length**2 * b.spread) for b in cad.bodies)
    return replace(cad, joints=joints, bodies=bodies, flange=length * cad.flange)


def _ten(body: Body) -> Array:
    tensor = body.inertia + body.mass * (body.centre @ body.centre * np.eye(3) - np.outer(body.centre, body.centre))
    return np.concatenate([[body.mass], body.mass * body.centre, tensor[[0, 0, 1, 0, 1, 2], [0, 1, 1, 2, 2, 2]]])


def _path(kind: Kind, cad: Mechanism, random: Random) -> Array:
    """Positions of the load (samples, n) at `FINE`; all derivatives below the fourth are continuous."""
    time = np.arange(round(kind.duration * FINE)) / FINE
    middle = np.mean([(j.lower, j.upper) for j in cad.joints], axis=1)
    reach = 0.35 * np.array([j.upper - j.lower for j in cad.joints])
    reach = np.minimum(reach, 1.2)
    count = len(reach)
    if kind.motion == "wander":
        frequency = random.uniform(0.06, 0.55, (count, 5))
        amplitude = random.uniform(0.2, 1.0, (count, 5)) / frequency
        amplitude *= (reach / amplitude.sum(axis=1))[:, None]
        angle = 2 * np.pi * frequency * time[:, None, None] + random.uniform(0, 2 * np.pi, (count, 5))
        return middle + (amplitude * np.sin(angle)).sum(-1)
    move, rest = (1.6, 0.3) if kind.motion == "program" else (kind.duration / (4 * count) * 0.85, 0.0)
    rest = rest or move * 0.15 / 0.85
    stops = middle + reach * random.uniform(-1, 1, (int(kind.duration / (move + rest)) + 2, count))
    if kind.motion == "single":  # four moves of each axis in turn
        for k in range(1, len(stops)):
            mine = (k - 1) // 4 % count
            others = np.arange(count) != mine
            stops[k, others] = stops[k - 1, others]
    number = np.minimum((time // (move + rest)).astype(int), len(stops) - 2)
    s = np.clip((time - number * (move + rest)) / move, 0, 1)[:, None]
    return stops[number] + (stops[number + 1] - stops[number]) * (35 * s**4 - 84 * s**5 + 70 * s**6 - 20 * s**7)


def _torques(kind: Kind, rigid: Rigid, path: Array, own: Array, random: Random) -> tuple[Array, Array]:
    """On the loads (samples, n), and the positions of the motors."""
    torque = _inverse(rigid, path)
    if not kind.elastic:
        return torque, path
    return torque, path + torque / (own * (2 * np.pi * random.uniform(8.0, 14.0, len(own))) ** 2)


def _inverse(rigid: Rigid, path: Array) -> Array:
    velocity = np.gradient(path, 1 / FINE, axis=0)
    acceleration = np.gradient(velocity, 1 / FINE, axis=0)
    model, data = rigid.model, rigid.data
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONSTRAINT
    torque = np.empty_like(path)
    for k, (data.qpos[:], data.qvel[:], data.qacc[:]) in enumerate(zip(path, velocity, acceleration, strict=True)):
        mujoco.mj_inverse(model, data)
        torque[k] = data.qfrc_inverse
    return torque


def _recorded(
    kind: Kind, cad: Mechanism, drives: tuple[Array, ...], run: int, path: Array, torque: Array, motor: Array,
    weights: Array, random: Random,
) -> tuple[Sweep, ...]:  # fmt: skip
    rotors, viscous, coulomb, offset = drives
    velocity = np.gradient(motor, 1 / FINE, axis=0)
    fast = np.abs(velocity).max(axis=0)

    def level(now: Now) -> Array:
        return coulomb * (1 + (0.25 if kind.rough else 0.0) * np.exp(-((now.velocity / (0.1 * fast)) ** 2)))

    bristle, zero = Bristle(level, REACH, random.uniform(-1, 1, len(cad.joints))), np.zeros(len(cad.joints))
    effort = torque + rotors * np.gradient(velocity, 1 / FINE, axis=0) + viscous * velocity + offset
    for k, speed in enumerate(velocity):
        now = Now(1 / FINE, 0.0, zero, speed, zero, zero, zero)
        effort[k] += bristle.opposes(now, speed)[0]
        bristle.moved(now, speed)
    if kind.rough:
        effort += 0.005 * np.abs(effort).max(axis=0) * np.sin(37.0 * motor + np.arange(motor.shape[1]))
    stride = round(FINE / kind.rate)
    kept = slice(0, None, stride)
    sensors = Sensors(0.01, 0.004, 2.0, 0.005, 2e-6, 2e-6, 0.0, 0.0)
    effort = effort[kept] + noise(sensors, effort[kept].shape, kind.rate, random) * weights
    position, load = (np.round(x[kept] / sensors.count) * sensors.count for x in (motor, path))
    speed = np.gradient(position, 1 / kind.rate, axis=0)
    return tuple(
        Sweep(
            SweepSpec(
                id=f"{run}-{name}", axis=name, pose=tuple(position[0].tolist()), offset_velocity=0.0,
                excitation="trajectory", sample_rate=kind.rate, started_at=100.0 * run,
            ),
            Recording(
                time=np.arange(len(effort)) / kind.rate, effort=effort[:, k], velocity=speed[:, k],
                position=position[:, k], load_position=load[:, k] if kind.encoders else None,
            ),
        )
        for k, name in enumerate(cad.names)
    )  # fmt: skip
