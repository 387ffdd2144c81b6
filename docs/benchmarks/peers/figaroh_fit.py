"""FIGAROH on a log: base parameters by double QR, weighted by axis, spread over the standard ones at least norm.

    python figaroh_fit.py LOG.npz ROBOT.urdf RESULT.npz

The log has samples (m, n) `q`, `dq`, `ddq`, `tau` and `gravity` (3,); the result `parameters` (14 n,): of the links in
the order of Pinocchio, then rotors, viscous and Coulomb friction and offsets of all axes; `seconds` of processor time.
"""

import sys
import time

import numpy as np
import pinocchio as pin
from figaroh.tools.qrdecomposition import QRDecomposer, redistribute_min_norm
from figaroh.tools.regressor import RegressorBuilder, RegressorConfig


class Robot:
    """What FIGAROH asks of a robot."""

    def __init__(self, urdf: str, gravity: np.ndarray) -> None:
        self.model = pin.buildModelFromUrdf(urdf)
        self.model.gravity.linear = gravity
        self.data = self.model.createData()


def main(log: str, urdf: str, result: str) -> None:
    given, began = np.load(log), time.process_time()
    count = given["q"].shape[1]
    config = RegressorConfig(has_friction=True, has_actuator_inertia=True, has_joint_offset=True)
    builder = RegressorBuilder(Robot(urdf, given["gravity"]), config)
    rows = builder.build_basic_regressor(given["q"], given["dq"], given["ddq"], {"act_idxv": range(count)})
    effort = given["tau"].T.ravel()
    shown = np.flatnonzero(np.linalg.norm(rows, axis=0) > 1e-6)
    names = [str(k) for k in shown]
    weight, values = np.ones(count), np.zeros(0)
    for _ in range(2):  # the second time with the noise of each axis
        each = np.repeat(weight, len(given["q"]))
        decomposer = QRDecomposer()
        *_, values = decomposer.double_decomposition(effort * each, rows[:, shown] * each[:, None], names)
        left = effort - rows[:, shown] @ redistribute_min_norm(decomposer.M, values)
        weight = 1 / left.reshape(count, -1).std(axis=1)
    parameters = np.zeros(14 * count)
    parameters[shown] = redistribute_min_norm(decomposer.M, values)
    viscous, coulomb, rotors, offsets = parameters[10 * count :].reshape(4, count)
    values = np.concatenate([parameters[: 10 * count], rotors, viscous, coulomb, offsets])
    np.savez(result, parameters=values, seconds=time.process_time() - began)


if __name__ == "__main__":
    main(*sys.argv[1:])
