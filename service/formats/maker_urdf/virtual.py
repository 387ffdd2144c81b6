"""Drafts a virtual machine of a robot: its scenario and drive profile, with controllers tuned to its axes.

Where the side file is not complete, the virtual machine gets plausible values, which are in its own side file. Its
links, motors and friction differ from the model, so there is something to find.
"""

import math
import xml.etree.ElementTree as ET
from dataclasses import dataclass

import numpy as np
import yaml
from pydantic import BaseModel, ConfigDict

from service import BadInput
from service.formats.maker_urdf.check import cell_text
from service.formats.maker_urdf.inertials import gravity_efforts, random_poses
from service.identification.model import inertia_rows
from service.model import Chain, Joint, Robot, RobotDescription, read_chain, robot_from_outside


@dataclass(frozen=True)
class _VirtualMachine:
    """The virtual machine, where the side file says nothing; mass, inertia and motor are relative to its model."""

    friction: float = 0.05
    """N m s/rad (N s/m) and N m (N), of the rated effort."""
    acceleration: float = 1.0
    """rad/s^2 (m/s^2)"""
    host_timeout: float = 3.0
    """s"""
    mass: float = 1.04
    inertia: float = 1.1
    motor: float = 1.05


_MACHINE = _VirtualMachine()


class _DraftedAxis(BaseModel):
    model_config = ConfigDict(extra="allow", allow_inf_nan=False)
    joint: str
    gear_ratio: float | None = None
    motor_inertia: float | None = None
    rated_effort: float | None = None
    viscous_friction: float | None = None


class DraftedRobot(BaseModel):
    """A side file in which values may be open."""

    model_config = ConfigDict(extra="allow", allow_inf_nan=False)
    name: str
    urdf: str
    axes: tuple[_DraftedAxis, ...]


@dataclass(frozen=True)
class _Load:
    """What an axis carries, over random poses: inertia of the links, and the largest effort of gravity."""

    least: float
    mean: float  # geometric
    most: float
    gravity: float


def virtual_machine(drafted: DraftedRobot, urdf_text: str, folder: str, eds: str, place: str) -> dict[str, str]:
    """Files by their path in a configuration `folder`. `eds`: of the virtual drives, relative to the drive profiles.

    BadInput if joints and URDF differ, or an axis could not hold its links.
    """
    name = f"{drafted.name}-virtual"
    chain = read_chain(urdf_text, place)
    if [axis.joint for axis in drafted.axes] != (moving := [joint.name for joint in chain.joints]):
        raise BadInput(f"{place} axes", f"differ from the URDF's moving joints: {', '.join(moving)}")
    loads = _loads(chain)
    axes = [_completed(*each) for each in zip(drafted.axes, chain.joints, loads, strict=True)]
    limited = _with_limits(urdf_text, axes)
    content = drafted.model_dump() | {
        "name": name,
        "urdf": f"{name}.urdf",
        "axes": [axis.model_dump() for axis in axes],
    }
    robot = robot_from_outside(RobotDescription.model_validate(content), limited, place)
    head = f"# A virtual machine, drafted: values that the side file of {drafted.name} left open are only plausible.\n"
    documents = {
        f"robots/{name}.yaml": content,
        f"scenarios/{name}.yaml": _scenario(robot, loads, name),
        f"drives/{name}.yaml": _profile(robot, loads, eds),
        "service.yaml": {
            "data_dir": f"{folder}/var",
            "drive": f"{folder}/drives/{name}.yaml",
            "robot": name,
            "cell": name,
            "robots_dir": f"{folder}/robots",
            "cells_dir": f"{folder}/cells",
            "virtual_machine": True,
        },
    }
    texts = {path: head + yaml.safe_dump(document, sort_keys=False, width=120) for path, document in documents.items()}
    return {f"robots/{name}.urdf": limited, f"cells/{name}.yaml": cell_text(robot, name)[0], **texts}


def _loads(chain: Chain) -> list[_Load]:
    poses = random_poses(chain)
    found: list[_Load] = []
    for k, gravity in enumerate(np.abs(gravity_efforts(chain, poses)).max(axis=0)):
        values = np.maximum(inertia_rows(chain, k, poses) @ chain.inertial.ravel(), 1e-6)
        mean = float(np.exp(np.log(values).mean()))
        found.append(_Load(float(values.min()), mean, float(values.max()), float(gravity)))
    return found


def _completed(axis: _DraftedAxis, joint: Joint, load: _Load) -> _DraftedAxis:
    # rad per rad; rad/m of a screw with 10 mm a turn
    ratio = axis.gear_ratio or {"revolute": 100.0, "prismatic": 2 * math.pi / 0.01}[joint.kind]
    needed = 1.5 * load.gravity + 2 * _MACHINE.acceleration * load.most
    rated = axis.rated_effort or (min(max(joint.effort / 2, needed), joint.effort) if joint.effort else needed)
    # motor inertia on the joint side, of the mean inertia of the links
    plausible = {
        "gear_ratio": ratio,
        "rated_effort": rated,
        "motor_inertia": 0.3 * load.mean / ratio**2,
        "viscous_friction": _MACHINE.friction * rated,
    }
    return axis.model_copy(update={key: value for key, value in plausible.items() if getattr(axis, key) is None})


def _with_limits(urdf_text: str, axes: list[_DraftedAxis]) -> str:
    """The URDF with a velocity and an effort limit for each axis."""
    root, wanted = ET.fromstring(urdf_text), {axis.joint: axis for axis in axes}
    for joint in root.findall("joint"):
        limit, axis = joint.find("limit"), wanted.get(joint.get("name", ""))
        if limit is not None and axis is not None:
            for key, value in (("velocity", 1.0), ("effort", 2 * (axis.rated_effort or 0.0))):
                if float(limit.get(key, "0")) <= 0:
                    limit.set(key, repr(value))
    return ET.tostring(root, encoding="unicode") + "\n"


def _scenario(robot: Robot, loads: list[_Load], name: str) -> dict[str, object]:
    axes: dict[str, object] = {}
    for axis, joint, load in zip(robot.axes, robot.chain.joints, loads, strict=True):
        motor = axis.reflected_motor_inertia or 0.0
        # 1/s of the speed control: in the mean, and in the lightest pose
        gain = min(100.0 * (load.mean + motor), 250.0 * (load.least + motor))
        friction = (axis.viscous_friction or 0.0) / 2
        axes[axis.joint] = {
            "train": {
                "motor_inertia": _MACHINE.motor * (axis.motor_inertia or 0.0),
                "motor_friction": {"viscous": 1.2 * friction, "coulomb": _MACHINE.friction * axis.rated_effort / 2},
                "load_friction": {"viscous": friction, "coulomb": _MACHINE.friction * axis.rated_effort / 4},
            },
            "control": {
                "gain": gain,
                "reset_time": max(0.05, 5 * (load.most + motor) / gain),
                "effort_limit": joint.effort,
            },
        }
    return {
        "name": name,
        "robot": f"../robots/{name}.yaml",
        "links": {joint.link: {"mass": _MACHINE.mass, "inertia": _MACHINE.inertia} for joint in robot.chain.joints},
        "axes": axes,
        "measurement": {
            "effort_noise": 0.002,
            "effort_resolution": 0.001,
            "velocity_noise": 5e-6,
            "position_noise": 2e-8,
            "load_position_noise": 1e-7,
            "load_velocity_noise": 2e-5,
        },
    }


def _profile(robot: Robot, loads: list[_Load], eds: str) -> dict[str, object]:
    axes: list[dict[str, object]] = []
    travel = {"rad": 3.2, "m": 3.2}
    for number, (axis, joint, load) in enumerate(zip(robot.axes, robot.chain.joints, loads, strict=True), 1):
        whole = _MACHINE.inertia * load.most + _MACHINE.motor * (axis.reflected_motor_inertia or 0.0)
        spare = (joint.effort - _MACHINE.mass * load.gravity) / whole
        if spare <= 0:
            raise BadInput(
                f"joint {axis.joint}",
                f"effort limit {joint.effort:g} is below its gravity of {load.gravity:.4g}: it cannot hold its links; "
                "correct masses or limit in the URDF",
            )
        unit, stop = ("m" if joint.kind == "prismatic" else "rad"), min(4.0, 0.8 * spare)  # rad/s^2 (m/s^2)
        speed = min(1.0, joint.velocity)  # rad/s (m/s)
        travel[unit] = max(travel[unit], speed * _MACHINE.host_timeout + speed**2 / (2 * stop))
        axes.append(
            {
                "joint": axis.joint,
                "node": number,
                "identity": {"vendor": 0x5357, "product": 0x0402, "revision": 0x00010000},
                "unit": unit,
                "gear_ratio": axis.gear_ratio,
                "rated_torque": axis.rated_effort / abs(axis.gear_ratio),
                "load_encoder": unit == "rad",
                "position_limits": [joint.lower, joint.upper],
                "velocity_limit": speed,
                "effort_limit": joint.effort,
                "acceleration": min(_MACHINE.acceleration, 0.5 * spare),
                "quick_stop_deceleration": stop,
                "standstill_velocity": 1e-3,
            }
        )
    return {
        "adapter": "canopen",
        "eds": eds,
        "bus": {
            "interface": "socketcand",
            "host": "127.0.0.1",
            "port": 29536,
            "channel": "can0",
            "sdo_timeout": 2.0,
            "drive_timeout": 2.0,
            "silence": 1.0,
            "host_timeout": _MACHINE.host_timeout,
            "missed_cycles": 1_000_000,
        },
        "travel_limits": travel,
        "emergency_stop_codes": [0x9000],
        "maker_settings": [{"name": "SYNC time-out in ms", "index": 0x2121, "sub": 1, "type": "H", "value": 2000}],
        "axes": axes,
    }
