"""What the rigid robot asks of one axis while all move, against Pinocchio."""

import numpy as np
import pinocchio as pin
import pytest

from service.identification.estimates.combination import combine
from service.identification.motion.equations import rigid_along, whole_parameters
from service.identification.motion.free_motion import free_motions
from tests.numeric.free_motion import GRAVITY, RATE, Truth, draw, log, wander


def split(truth: Truth, q: np.ndarray, v: np.ndarray, a: np.ndarray) -> np.ndarray:
    """Inertia, gravity and coupling (3, m, n) of the true robot."""
    model = pin.buildModelFromXML(truth.robot.urdf_text)
    model.gravity.linear = np.array(GRAVITY)
    for k, link in enumerate(truth.links):
        model.inertias[k + 1] = pin.Inertia.FromDynamicParameters(link)
    data = model.createData()
    inertia, gravity, whole = [], [], []
    for x, dx, ddx in zip(q, v, a, strict=True):
        inertia.append(np.diag(pin.crba(model, data, x)).copy())
        gravity.append(pin.rnea(model, data, x, 0 * dx, 0 * ddx).copy())
        whole.append(pin.rnea(model, data, x, dx, ddx).copy())
    coupling = np.array(whole) - np.array(gravity) - np.array(inertia) * a
    return np.array([np.array(inertia) + truth.motor, gravity, coupling])


@pytest.mark.parametrize("seed", [300, 301, 302, 303])
def test_the_split_is_pinocchios(seed: int) -> None:
    truth = draw(seed, 3 + seed % 4)
    path = wander(np.random.default_rng(seed), len(truth.robot.axes))
    records = free_motions(truth.robot, log(truth, path, seed, duration=10.0, encoder=0.0))
    (found,) = rigid_along(truth.robot, truth.parameters, records)
    q, v, a = path(np.arange(round(10.0 * RATE)) / RATE)
    expected = split(truth, q, v, a)
    for k, joint in enumerate(truth.robot.joints):
        axis, sound = found[joint], found[joint].sound
        for mine, other in zip((axis.inertia, axis.gravity, axis.coupling), expected[:, :, k], strict=True):
            np.testing.assert_allclose(mine[sound], other[sound], atol=1e-3 * np.abs(expected[:, :, k]).max())
        assert sound.mean() > 0.9


def test_less_the_coupling_an_axis_is_one_alone() -> None:
    """With identified parameters: what is left of effort is friction, offset, ripple and noise."""
    truth = draw(310, 4)
    path = wander(np.random.default_rng(310), 4)
    sweeps = log(truth, path, 310)
    records = free_motions(truth.robot, sweeps)
    found = combine(truth.robot, (), (), records)
    (along,) = rigid_along(truth.robot, whole_parameters(truth.robot, found.base, found.solution.values), records)
    _, v, _ = path(np.arange(round(40.0 * RATE)) / RATE)
    for k, joint in enumerate(truth.robot.joints):
        left = sweeps[k].recording.effort - along[joint].rigid
        friction = truth.viscous[k] * v[:, k] + truth.coulomb[k] * np.sign(v[:, k]) + truth.offset[k]
        rated = truth.robot.axes[k].rated_effort
        error = np.sqrt(np.mean((left - friction)[along[joint].sound] ** 2))
        # ripple 0.4 % / sqrt 2 and noise 0.4 % of the rated effort are 0.49 %
        assert error < 0.007 * rated
        coupling = np.sqrt(np.mean(along[joint].coupling ** 2))
        assert coupling > 0.005 * rated  # there is something to take away
