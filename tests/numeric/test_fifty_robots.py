"""Regressor and base-parameter rank against Pinocchio on 50 random robots of 3 to 7 axes, revolute and prismatic."""

import numpy as np
import pinocchio as pin

from service.identification.model.base_parameters import base_parameters
from service.identification.model.regressor import inertia_rows
from service.urdf import Chain, read_chain
from tests.random_chain import random_urdf

ROBOTS = 50
POSES = 40


def test_regressor_and_rank_are_pinocchios() -> None:
    worst, ranks, kinds = 0.0, [], {"revolute": 0, "prismatic": 0}
    for seed in range(ROBOTS):
        rng = np.random.default_rng(1000 + seed)
        joints = 3 + seed % 5
        text = random_urdf(rng, joints, prismatic=0.3)
        chain = read_chain(text)
        for joint in chain.joints:
            kinds[joint.kind] += 1
        poses = rng.uniform(-2.5, 2.5, (POSES, joints))
        expected = pinocchios_rows(text, poses)
        own = np.stack([inertia_rows(chain, k, poses) for k in range(joints)], 1)
        worst = max(worst, float(np.abs(own - expected).max() / np.abs(expected).max()))
        rank = np.linalg.matrix_rank(with_motors(expected), tol=1e-7)
        assert number_of_base_parameters(chain) == rank, f"robot {seed}"
        ranks.append(int(rank))
    print(
        f"{ROBOTS} robots, {kinds['revolute']} revolute and {kinds['prismatic']} prismatic joints: largest difference "
        f"of a regressor {worst:.1e} of its largest entry, all ranks equal ({min(ranks)} to {max(ranks)})"
    )
    assert worst < 1e-12
    assert min(kinds.values()) > 50


def pinocchios_rows(text: str, poses: np.ndarray) -> np.ndarray:
    """(m, n, 10 n): row k of the torque regressor for unit acceleration of joint k from standstill, without gravity."""
    model = pin.buildModelFromXML(text)
    model.gravity.linear = np.zeros(3)
    data, standstill = model.createData(), np.zeros(model.nv)
    return np.array(
        [
            [
                pin.computeJointTorqueRegressor(model, data, pose, standstill, unit)[k].copy()
                for k, unit in enumerate(np.eye(model.nv))
            ]
            for pose in poses
        ]
    )


def with_motors(rows: np.ndarray) -> np.ndarray:
    """(m n, 11 n): the motor inertia of axis k is in the rows of axis k alone."""
    poses, joints, _ = rows.shape
    motors = np.broadcast_to(np.eye(joints), (poses, joints, joints))
    return np.concatenate([rows, motors], -1).reshape(poses * joints, -1)


def number_of_base_parameters(chain: Chain) -> int:
    return len(base_parameters(chain, tuple(range(len(chain.joints)))).columns)
