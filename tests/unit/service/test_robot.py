"""Frames and nominal inertial parameters of random chains, against Pinocchio reading the same URDF."""

import sys
from importlib import import_module

import numpy as np
import pytest
from pydantic import ValidationError

from service import BadInput
from service.model import Axis, RobotDescription, build_robot, link_frames, read_chain

pinocchio = (  # elsewhere it must be there
    pytest.importorskip("pinocchio", reason="the oracle has no Windows wheels")
    if sys.platform == "win32"
    else import_module("pinocchio")
)


def numbers(values: np.ndarray) -> str:
    return " ".join(f"{value:.12g}" for value in values)


def random_urdf(seed: int) -> str:
    """Up to 12 joints in a row, a third of them fixed, with bodies at and beside the chain."""
    rng = np.random.default_rng(seed)
    parts = ['<link name="l0"/>']
    for k in range(1, rng.integers(3, 13)):
        kind = "revolute" if k == 1 else rng.choice(["revolute", "prismatic", "fixed"])
        root = rng.normal(size=(3, 3))
        inertia = root @ root.T + np.eye(3)
        tensor = " ".join(
            f'i{"xyz"[i]}{"xyz"[j]}="{inertia[i, j]:.12g}"' for i, j in ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))
        )
        body = (
            f'<inertial><origin xyz="{numbers(rng.normal(size=3))}" rpy="{numbers(rng.normal(size=3))}"/>'
            f'<mass value="{rng.uniform(0.1, 50):.12g}"/><inertia {tensor}/></inertial>'
        )
        parts.append(
            f'<joint name="j{k}" type="{kind}"><parent link="l{k - 1}"/><child link="l{k}"/>'
            f'<origin xyz="{numbers(rng.normal(size=3))}" rpy="{numbers(rng.uniform(-3, 3, 3))}"/>'
            f'<axis xyz="{numbers(rng.normal(size=3))}"/><limit lower="-3" upper="3" velocity="1" effort="1"/></joint>'
            f'<link name="l{k}">{body if rng.random() < 0.8 else ""}</link>'
        )
        if rng.random() < 0.4:  # a motor or a box bolted to the link
            parts.append(
                f'<joint name="b{k}" type="fixed"><parent link="l{k}"/><child link="x{k}"/>'
                f'<origin xyz="{numbers(rng.normal(size=3))}" rpy="{numbers(rng.normal(size=3))}"/></joint>'
                f'<link name="x{k}">{body}</link>'
            )
    return f'<robot name="random">{"".join(parts)}</robot>'


@pytest.mark.parametrize("seed", range(20))
def test_a_random_chain_is_what_pinocchio_reads(seed: int) -> None:
    text = random_urdf(seed)
    chain = read_chain(text)
    oracle = pinocchio.buildModelFromXML(text)
    assert [joint.name for joint in chain.joints] == list(oracle.names)[1:]
    expected = np.array([inertia.toDynamicParameters() for inertia in oracle.inertias[1:]])
    np.testing.assert_allclose(chain.inertial, expected, rtol=1e-9, atol=1e-9)

    poses = np.random.default_rng(seed).uniform(-3, 3, (4, len(chain.joints)))
    rotations, origins = link_frames(chain, poses)
    data = oracle.createData()
    for pose, rotation, origin in zip(poses, rotations, origins, strict=True):
        pinocchio.forwardKinematics(oracle, data, pose)
        for k in range(len(chain.joints)):
            np.testing.assert_allclose(rotation[k], data.oMi[k + 1].rotation, atol=1e-10)
            np.testing.assert_allclose(origin[k], data.oMi[k + 1].translation, atol=1e-9)


def test_the_motor_weighs_with_the_square_of_the_gear() -> None:
    axis = Axis(joint="j", gear_ratio=-100.0, motor_inertia=0.002, rated_effort=10.0)
    assert axis.reflected_motor_inertia == pytest.approx(20.0)
    assert Axis(joint="j", gear_ratio=1.0, rated_effort=1.0).reflected_motor_inertia is None


@pytest.mark.parametrize(
    ("field", "value"), [("gear_ratio", 0.0), ("cogging_orders", (24, 0)), ("transmission_orders", (-1,))]
)
def test_what_would_divide_by_zero_is_refused(field: str, value: object) -> None:
    with pytest.raises(ValidationError, match=field):
        Axis.model_validate({"joint": "a", "gear_ratio": 10.0, "rated_effort": 1.0, field: value})


def test_axes_must_be_the_moving_joints_of_the_urdf() -> None:
    axis = Axis(joint="j", gear_ratio=-100.0, rated_effort=10.0)
    with pytest.raises(BadInput, match="differ from the URDF's moving joints"):
        build_robot(RobotDescription(name="r", urdf="r.urdf", axes=(axis,)), random_urdf(1))
