"""Every entry of the catalogue is complete, and its columns are what its names promise."""

from itertools import product

import numpy as np
import pytest

from service.diagnosis.effects import CATALOGUE
from service.diagnosis.effects.drive_train.backlash import missing
from service.diagnosis.effects.effect import Model
from service.diagnosis.effects.friction.friction_temperature_drift import warmth
from service.diagnosis.rows.signals import Tracks, bristle, tracks
from service.diagnosis.sensitivity.predicted_sweeps import expected
from service.identification.design.diagnosis_sweeps import full_design
from tests.numeric.campaign import max100


@pytest.fixture(scope="module")
def motion() -> Tracks:
    robot = max100()
    poses = np.array([[0.0, -0.8, 0.3, 0, 0, 0], [0.0, 0.5, -0.9, 0, 0, 0]])
    designed = full_design(robot, "joint_2", poses, repeats=1)
    return tracks(robot, "joint_2", [expected(sweep, sweep.spec.pose[1]) for sweep in designed])


def model_of(motion: Tracks, inertia: float = 300.0, viscous: float = 200.0, *, weight: float = 1.0) -> Model:
    """A motor of 66 kg m^2 that carries so much of CAD's weight."""
    none = np.zeros(len(motion.specs))
    return Model(none + inertia, 66.0, viscous, weight * motion.gravity, none, none)


@pytest.mark.parametrize("name", list(CATALOGUE))
def test_columns_names_and_bounds_agree(name: str, motion: Tracks) -> None:
    effect, model = CATALOGUE[name], model_of(motion)
    assert effect.applies(motion)
    shapes = effect.shape(motion, model)
    assert all(shape.low <= value <= shape.high for shape in shapes for value in shape.grid)
    shape = next(product(*(one.grid for one in shapes)))
    columns = effect.columns(motion, model, shape)
    assert len(columns) == len(effect.coefficients(motion))
    assert effect.by_load == (not columns) == (effect.readout is not None)
    assert effect.by_load or len(columns) > effect.essential
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
    assert bristle(motion.position, way)[row, here] == pytest.approx(1 - np.exp(-gone[here] / way), rel=1e-9)


def test_a_gear_that_hardly_cools_is_as_warm_as_it_has_gone_far(motion: Tracks) -> None:
    way = np.sum(np.abs(motion.velocity) * motion.inside) / motion.rate
    last = max(range(len(motion.specs)), key=lambda k: motion.specs[k].started_at)
    assert warmth(motion, 1e9)[last, -1] == pytest.approx(way, rel=1e-6)


@pytest.mark.parametrize("name", list(CATALOGUE))
def test_columns_that_depend_on_the_fitted_model_say_so(name: str, motion: Tracks) -> None:
    """Others are kept when the model moves."""
    effect, weight = CATALOGUE[name], float(name != "backlash")  # weight keeps the flanks together
    shape = next(product(*(one.grid for one in effect.shape(motion, model_of(motion)))))
    one, other = (
        effect.columns(motion, model_of(motion, inertia, viscous, weight=weight), shape)
        for inertia, viscous in ((300.0, 200.0), (350.0, 250.0))
    )
    assert effect.of_model == any(not np.array_equal(a, b) for a, b in zip(one, other, strict=True))


def test_play_found_in_many_shapes_at_once_is_that_of_each(motion: Tracks) -> None:
    effect, model = CATALOGUE["backlash"], model_of(motion, weight=0.0)
    shapes = [(1e-5, 0.5), (1e-4, 0.2), (3e-4, 0.9)]
    assert effect.scan is not None
    for shape, found in zip(shapes, effect.scan(motion, model, shapes), strict=True):
        assert found[0].any()
        assert np.array_equal(found[0], effect.columns(motion, model, shape)[0])


def test_within_a_very_wide_play_the_motor_never_meets_the_load(motion: Tracks) -> None:
    """Without gravity and friction the load stays at rest: all of its inertia torque is missing."""
    inertia, none = np.array([250.0]), np.zeros(1)
    weightless = np.zeros_like(motion.gravity)
    lost = missing(motion, weightless, np.array([0]), inertia, none, np.array([10.0]))[0, 0]
    expected_torque = -250.0 * motion.acceleration[0]
    middle = slice(20, -20)
    assert lost[middle] == pytest.approx(expected_torque[middle], abs=0.02 * float(np.abs(expected_torque).max()))
