"""Simultaneous sweeps of a random arm: all links free in MuJoCo, motors behind springs or rigid, dry friction that can
stick, a cascade for every axis. Axes that are not named are braked.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from service.model import Axis, Prior, Robot, RobotDescription, build_robot
from tests.numeric.second_plant.bodies import Rigid
from tests.numeric.second_plant.machine import STEP
from tests.numeric.second_plant.robots import Mechanism, put_off, random_mechanism, urdf

Array = NDArray[np.float64]

RATE = 1000.0  # Hz
REACH = 2e-6  # rad, over which friction builds up
BRAKED = 1e9  # kg m^2: rotor of an axis that is braked


@dataclass(frozen=True)
class Arm:
    """As on paper (`robot`) and as built; arrays (n,), SI on the joint side. `stiffness` is infinite for a rigid gear.

    `rotors`, `friction`, `locked` (Hz): motor inertia, viscous friction and locked-rotor frequency as on paper.
    `compliance`: what an initial analysis says of the elastic axes, 2 % off.
    """

    robot: Robot
    built: Mechanism
    motor: Array
    viscous: Array
    dry: Array
    stiffness: Array
    rated: Array
    compliance: dict[str, float]
    rotors: Array
    friction: Array
    locked: Array

    def matrix(self, pose: Array) -> Array:
        """True M(q) with the motors."""
        return Rigid(self.built).matrix(pose) + np.diag(self.motor)


def arm(seed: int, axes: int) -> Arm:
    """CAD off by 10 to 18 %; every second axis or so elastic, 11 to 16 Hz; dry friction of 3 to 8 % of rated."""
    random = np.random.default_rng([33, seed, axes])
    while True:
        cad = random_mechanism(random, "arm", "arm")
        if len(cad.joints) == axes:
            break
    built = put_off(cad, 0.10, 0.18, random)
    limits = np.array([(joint.lower, joint.upper) for joint in cad.joints])
    poses = random.uniform(limits[:, 0] + 0.4, limits[:, 1] - 0.4, (12, axes))
    rigid = Rigid(cad)
    inertia = np.array([np.diag(rigid.matrix(pose)) for pose in poses]).mean(axis=0)
    weight = np.array([np.abs(rigid.holding(pose)) for pose in poses]).max(axis=0)
    rated = np.maximum(np.round(np.maximum(5.5 * inertia, 1.75 * weight), -1), 10.0)
    on_paper = inertia * random.uniform(0.2, 0.7, axes)
    motor = on_paper * (1 + 0.1 * np.clip(random.normal(size=axes), -1.5, 1.5))
    viscous, ratios = rated * random.uniform(0.2, 0.4, axes), np.round(random.uniform(60.0, 250.0, axes), 1)
    elastic = random.random(axes) < 0.5
    elastic[random.integers(axes)] = True
    locked = np.where(elastic, random.uniform(11.0, 16.0, axes), np.inf)
    stiffness = np.where(elastic, inertia * (2 * np.pi * np.where(elastic, locked, 1.0)) ** 2, np.inf)
    description = RobotDescription(
        name="arm", urdf="robot.urdf",
        axes=tuple(
            Axis(joint=joint, gear_ratio=float(u), motor_inertia=float(jm / u**2), rated_effort=float(effort),
                 viscous_friction=float(v), cogging_orders=())
            for joint, u, jm, effort, v in zip(cad.names, ratios, on_paper, rated, viscous, strict=True)
        ),
        prior=Prior(inertia=0.3, gravity=0.3, viscous_friction=0.5, motor_inertia=0.1, effort_gain=0.05),
    )  # fmt: skip
    compliance = {
        joint: float((1 + 0.02 * random.normal()) / stiffness[k]) for k, joint in enumerate(cad.names) if elastic[k]
    }
    return Arm(
        build_robot(description, urdf(cad)), built, motor, viscous * random.uniform(0.75, 1.3, axes),
        rated * random.uniform(0.03, 0.08, axes), stiffness, rated, compliance,
        on_paper, viscous, locked,
    )  # fmt: skip


def run(
    plant: Arm, moving: Sequence[int], pose: Array, wanted: Array, random: np.random.Generator
) -> tuple[Array, Array, Array]:
    """Time (n,), torque asked for and motor position (n, moving) as recorded at `RATE`, for the velocities `wanted`
    (steps, moving) of `STEP`. Effort noise of 0.15 % of rated.
    """
    torque, position = (signal[:: round(1 / STEP / RATE)] for signal in _stepped(plant, moving, pose, wanted))
    noise = 0.0015 * plant.rated[list(moving)]
    torque = torque + noise * random.normal(size=torque.shape)
    position = position + 5e-9 * random.normal(size=position.shape)
    return np.arange(len(torque)) / RATE, torque, position


def _stepped(plant: Arm, moving: Sequence[int], pose: Array, wanted: Array) -> tuple[Array, Array]:
    """Torque asked for and motor position, (steps, moving), of one instant.

    A step's velocity belongs to its middle: half a step's viscous friction counts as inertia, which centres it.
    """
    rigid, own = Rigid(plant.built), list(moving)
    model, data = rigid.model, rigid.data
    held = rigid.holding(pose)
    elastic = np.isfinite(plant.stiffness[own])
    stiffness = np.where(elastic, plant.stiffness[own], 0.0)
    damping = 0.002 * stiffness
    model.opt.timestep, model.opt.integrator = STEP, mujoco.mjtIntegrator.mjINT_EULER
    model.jnt_limited[:] = 0
    model.dof_armature[:] = BRAKED
    model.dof_armature[own] = np.where(elastic, 0.0, plant.motor[own] + STEP / 2 * plant.viscous[own])
    mujoco.mj_resetData(model, data)
    data.qpos[:] = pose
    change = np.gradient(wanted, STEP, axis=0)
    goal = np.cumsum(wanted, axis=0) * STEP
    motor, viscous, dry = plant.motor[own], plant.viscous[own], plant.dry[own]
    load = np.diag(plant.matrix(pose))[own]
    speed = load * 2 * np.pi * np.where(elastic, 4.0, 10.0)
    begin = pose[own] + np.divide(held[own], stiffness, out=np.zeros(len(own)), where=elastic)
    angle, velocity, force = begin.copy(), np.zeros(len(own)), np.zeros(len(own))
    integral = held[own].copy()
    torque, position = np.empty_like(wanted), np.empty_like(wanted)
    for n in range(len(wanted)):
        q, v = data.qpos[own].copy(), data.qvel[own].copy()
        angle, velocity = np.where(elastic, angle, q), np.where(elastic, velocity, v)
        position[n] = angle
        error = wanted[n] + 2.0 * (goal[n] - angle + begin) - velocity
        integral += STEP * 8.0 * speed * error
        asked = load * change[n] + viscous * wanted[n] + speed * error + integral
        torque[n] = asked
        # Dahl's friction, exact for a constant velocity over the step
        towards = dry * np.sign(velocity)
        force = towards + (force - towards) * np.exp(-np.abs(velocity) * STEP / REACH)
        net = asked - viscous * velocity - force
        spring = stiffness * (angle - q) + damping * (velocity - v)
        data.qfrc_applied[:] = held
        data.qfrc_applied[own] = np.where(elastic, spring, net)
        velocity = velocity + STEP * (net - spring) / (motor + STEP / 2 * viscous)
        angle = angle + STEP * velocity
        mujoco.mj_step(model, data)
    return torque, position
