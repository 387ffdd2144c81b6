"""Every entry of the catalogue is complete, and its columns are what its names promise."""

from itertools import product

import numpy as np
import pytest

from service.diagnosis.design import full_design
from service.diagnosis.effects import CATALOGUE
from service.diagnosis.effects.effect import Model
from service.diagnosis.effects.friction_temperature_drift import warmth
from service.diagnosis.effects.presliding_hysteresis import bristle
from service.diagnosis.experiments import expected
from service.diagnosis.signals import Tracks, tracks
from tests.numeric.campaign import max100

NAMES = [
    "coulomb_friction",
    "asymmetric_friction",
    "stribeck_friction",
    "nonlinear_viscous_friction",
    "load_dependent_friction",
    "friction_temperature_drift",
    "gravity_error",
    "hose_spring",
    "joint_elasticity",
    "measurement_delay",
    "cogging_torque",
    "transmission_error",
    "presliding_hysteresis",
    "backlash",
    "effort_offset",
    "torque_constant_error",
    "payload",
]


@pytest.fixture(scope="module")
def motion() -> Tracks:
    robot = max100()
    poses = np.array([[0.0, -0.8, 0.3, 0, 0, 0], [0.0, 0.5, -0.9, 0, 0, 0]])
    designed = full_design(robot, "joint_2", poses, repeats=1)
    return tracks(robot, "joint_2", [expected(sweep, sweep.spec.pose[1]) for sweep in designed])


def test_all_effects_are_there() -> None:
    assert list(CATALOGUE) == sorted(CATALOGUE, key=NAMES.index)
    assert len(CATALOGUE) == len(NAMES)


@pytest.mark.parametrize("name", NAMES)
def test_columns_names_and_bounds_agree(name: str, motion: Tracks) -> None:
    effect, model = CATALOGUE[name], Model(np.full(len(motion.specs), 300.0), 66.0, 200.0)
    assert effect.applies(motion)
    shapes = effect.shape(motion, model)
    assert all(shape.low <= value <= shape.high for shape in shapes for value in shape.grid)
    shape = next(product(*(one.grid for one in shapes)))
    columns = effect.columns(motion, model, shape)
    assert len(columns) == len(effect.coefficients(motion)) > effect.essential
    for column in columns:
        assert column.shape == motion.velocity.shape
        assert np.isfinite(column).all()
    for text in (effect.physics, effect.source, effect.sentence, effect.entry):
        assert text


def test_bristles_follow_dahl(motion: Tracks) -> None:
    """From rest over a way of three bristle lengths: 1 - exp(-3)."""
    row, way = 0, 1e-3
    gone = motion.position[row] - motion.position[row, 0]
    here = int(np.searchsorted(gone, 3 * way))
    assert bristle(motion, way)[row, here] == pytest.approx(1 - np.exp(-gone[here] / way), rel=1e-9)


def test_a_gear_that_hardly_cools_is_as_warm_as_it_has_gone_far(motion: Tracks) -> None:
    way = np.sum(np.abs(motion.velocity) * motion.inside) / motion.rate
    last = max(range(len(motion.specs)), key=lambda k: motion.specs[k].started_at)
    assert warmth(motion, 1e9)[last, -1] == pytest.approx(way, rel=1e-6)
