"""Known effects are read from a model's document, and what cannot be used is told."""

from typing import Any

import numpy as np
import pytest

from service.model.errors import BadInput
from tests.unit.service.identification.known import known, model, read

FRICTION = {"coulomb": (90.0, 2.0), "extra": (40.0, 3.0), "velocity": (0.006, 0.0005), "exponent": (2.0, 0.1)}


def test_values_and_deviations_are_those_of_the_document() -> None:
    effect = known(lift={"stribeck_friction": FRICTION}).of("lift").effects[0]
    assert dict(effect.values) == {name: value for name, (value, _) in FRICTION.items()}
    assert effect.std == pytest.approx({name: std for name, (_, std) in FRICTION.items()})
    assert not known(lift={}).of("another").effects


def test_correlations_are_those_of_the_covariance_and_directions_are_its_root() -> None:
    document = model(lift={"load_dependent_friction": {"coulomb": (90.0, 4.0), "load_dependence": (0.05, 0.01)}})
    document["axes"]["lift"]["effects"][0]["covariance"] = [[4.0, -0.008], [-0.008, 2.5e-5]]  # correlation -0.8
    effect = read(document, "lift").of("lift").effects[0]
    np.testing.assert_allclose(effect.covariance, [[16.0, -0.032], [-0.032, 1e-4]])
    root = np.array([list(step.values()) for step in effect.directions()])
    np.testing.assert_allclose(root.T @ root, effect.covariance, rtol=1e-12)


def test_what_is_exactly_known_moves_nothing() -> None:
    effect = known(lift={"coulomb_friction": {"coulomb": (90.0, 0.0)}}).of("lift").effects[0]
    assert effect.directions() == [{"coulomb": 0.0}]


@pytest.mark.parametrize(
    ("effects", "why"),
    [
        ({"measurement_delay": {"lag": (1e-3, 1e-5)}}, "it has no parameter delay"),
        (
            {"joint_elasticity": {"compliance": (-1e-6, 1e-7), "damping_time": (1e-3, 1e-4)}},
            "its compliance is not above 0",
        ),
        ({"torque_constant_error": {"gain_error": (-1.2, 0.1)}}, "its 1 + gain_error is not above 0"),
    ],
)
def test_an_effect_that_says_nothing_is_left_out(effects: dict[str, dict[str, tuple[float, float]]], why: str) -> None:
    axis = known(lift=effects).of("lift")
    (name,) = effects
    assert axis.get(name) is None
    assert axis.effects[0].unusable.startswith(why)


def with_covariance(told: list[Any]) -> dict[str, Any]:
    document = model(lift={"a": {"b": (1.0, 1.0)}})
    document["axes"]["lift"]["effects"][0]["covariance"] = told
    return document


def test_an_effect_without_parameters_is_read() -> None:
    assert known(lift={"a": {}}).of("lift").effects[0].covariance.shape == (0, 0)


def test_a_variance_without_a_root_gives_no_correlations() -> None:
    document = with_covariance([[5e-324, 1.0], [1.0, 5e-324]])
    document["axes"]["lift"]["effects"][0]["parameters"]["c"] = {"value": 1.0, "std": 2.0}
    effect = read(document, "lift").of("lift").effects[0]
    np.testing.assert_array_equal(effect.covariance, np.diag([1.0, 4.0]))


@pytest.mark.parametrize(
    ("document", "message"),
    [
        ({}, r"model\.axes: Field required"),
        (
            {"axes": {"joint_9": {"effects": []}}},
            r"model\.axes\.joint_9: is not a joint of the robot; its joints are lift",
        ),
        ({"axes": {"lift": []}}, r"model\.axes\.lift: Input should be"),
        ({"axes": {"lift": {"effects": {}}}}, r"lift\.effects: Input should be"),
        ({"axes": {"lift": {"effects": [{}]}}}, r"lift\.effects\.0\.effect: Field required"),
        (model(lift={"a": {"b": (float("nan"), 1.0)}}), r"effects\.a\.b\.value: nan is not a finite number"),
        (model(lift={"a": {"b": (10**400, 1.0)}}), r"effects\.0\.parameters\.b\.value: Input should be a valid number"),
        (model(lift={"a": {"b": (1.0, -1.0)}}), r"effects\.a\.b\.std: -1\.0 is below 0"),
        (with_covariance([[1.0], [1.0, 2.0]]), r"effects\.a\.covariance: has rows of different lengths"),
        (with_covariance([["x"]]), r"effects\.0\.covariance\.0\.0: Input should be a valid number"),
    ],
)
def test_what_cannot_be_read_is_named(document: dict[str, Any], message: str) -> None:
    with pytest.raises(BadInput, match=message):
        read(document, "lift")
