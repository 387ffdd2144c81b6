"""A diagnosis that starts from an estimate, or from effects that the model has already."""

import copy
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from service import BadInput
from service.diagnosis import axis_document, diagnose_axis
from service.diagnosis.effects import CATALOGUE
from service.diagnosis.fit.equations import Term
from service.diagnosis.fit.fitted import Parameter
from service.diagnosis.rows.rigid import load_rows, nominal_parameters, parameter_spread
from service.diagnosis.rows.signals import Tracks
from service.formats.export.started_robot import started_from
from service.identification.design.diagnosis_sweeps import full_design
from service.identification.estimation import estimate_document, sweep_spectrum
from service.model import INERTIAL_NAMES, Robot, Sweep
from tests.numeric.campaign import max100
from tests.unit.service.diagnosis.following import RATE, SLOW, following, known_to, swept

pytestmark = pytest.mark.slow

Array = NDArray[np.float64]

JOINT = "joint_2"
PRIOR = 0.02
OFF = 0.6  # part by which CAD's centre of mass of the forearm is off: thirty sigma of it
FOREARM = 2


def poses(seed: int, count: int) -> Array:
    random = np.random.default_rng(seed)
    angles = random.uniform((-0.8, -1.0), (0.8, 1.0), (count, 2))
    return np.hstack([np.zeros((count, 1)), angles, np.zeros((count, 3))])


def off(robot: Robot) -> Array:
    """What the machine has beside CAD (11 n,): a forearm that is heavy further out."""
    error = np.zeros(11 * len(robot.joints))
    moment = 10 * FOREARM + INERTIAL_NAMES.index("mx")
    error[moment] = OFF * max(np.abs(robot.chain.inertial[FOREARM, 1:4]))
    return error


def machine(robot: Robot) -> Callable[[Tracks], Array]:
    return lambda motion: (load_rows(robot, 1, motion.poses) @ off(robot)).reshape(3, -1)


@pytest.fixture(scope="module")
def robot() -> Robot:
    return known_to(PRIOR)


@pytest.fixture(scope="module")
def estimate(robot: Robot) -> dict[str, Any]:
    designed = full_design(robot, JOINT, poses(1, 12), blocks=SLOW, sample_rate=RATE, revisit=False)
    sweeps = following(robot, JOINT, designed, load=machine(robot), seed=5)
    return estimate_document(robot, [sweep_spectrum(robot, sweep) for sweep in sweeps]).as_json()


def diagnosed(robot: Robot, measured: Robot) -> Mapping[str, Any]:
    designed = full_design(
        measured, JOINT, poses(2, 4), blocks=("forward_slow", "backward_slow", "wide"), sample_rate=RATE
    )
    sweeps = following(measured, JOINT, designed, load=machine(measured))
    return axis_document(diagnose_axis(robot, JOINT, sweeps, twin=False)).as_json()


def test_cad_that_is_off_beyond_its_prior_is_told_and_not_when_an_estimate_put_it_right(
    robot: Robot, estimate: dict[str, Any]
) -> None:
    by_cad = diagnosed(robot, robot)
    assert by_cad["started_from"] == "cad"
    assert (by_cad["verdict"], [effect["effect"] for effect in by_cad["effects"]]) == ("ambiguous", ["payload"])
    found = diagnosed(started_from(robot, estimate, "campaign 1, revision 24"), robot)
    assert (found["verdict"], found["effects"]) == ("none", [])
    assert found["started_from"] == "campaign 1, revision 24"


def test_the_nominal_values_are_the_estimates_and_no_direction_is_known_worse(
    robot: Robot, estimate: dict[str, Any]
) -> None:
    started = started_from(robot, estimate, "estimate")
    knowledge = started.knowledge
    assert knowledge is not None
    told = [one for one in estimate["base_parameters"] if one["std"] is not None]
    value, std = (np.array([one[key] for one in told]) for key in ("value", "std"))
    assert np.all(np.abs(knowledge.combination @ nominal_parameters(started) - value) < 0.1 * std)
    anywhere = poses(3, 30)
    before, after = (
        knowledge.combination @ parameter_spread(one, 1, anywhere)
        for one in (replace(started, knowledge=None), started)
    )
    held, known = np.linalg.norm(before, axis=1), np.linalg.norm(after, axis=1)
    assert np.all(known <= 1.001 * held)
    assert np.all(known <= 1.001 * np.sqrt(np.diag(knowledge.covariance)))
    assert np.all(np.diag(knowledge.covariance) > std**2)  # a torque gain's error is shared by all


def test_what_no_data_told_is_as_uncertain_as_before(robot: Robot, estimate: dict[str, Any]) -> None:
    started = started_from(robot, estimate, "estimate")
    unseen = 10 * 1 + INERTIAL_NAMES.index("mx")  # of the upper arm: its inertia does not show where its centre is
    before, after = (np.linalg.norm(parameter_spread(one, 1, poses(3, 30)), axis=1) for one in (robot, started))
    assert after[unseen] > 0.9 * before[unseen]


def test_an_estimate_of_before_has_no_covariance_and_is_taken_all_the_same(
    robot: Robot, estimate: dict[str, Any]
) -> None:
    old = {key: value for key, value in estimate.items() if key != "base"}
    with pytest.raises(BadInput, match="base_parameters: are not those of robot"):  # it locked what never moved
        started_from(robot, old, "old")
    old["base"] = {"locked": estimate["base"]["locked"]}
    knowledge = started_from(robot, old, "old").knowledge
    assert knowledge is not None
    assert np.count_nonzero(knowledge.covariance) == len(knowledge.covariance)


def test_an_estimate_of_another_robot_is_one_clear_error(robot: Robot, estimate: dict[str, Any]) -> None:
    other = copy.deepcopy(estimate)
    other["base_parameters"][0]["name"] = "Izz(turret)"
    with pytest.raises(BadInput) as error:
        started_from(robot, other, "other", "other.json")
    assert error.value.place == "other.json base_parameters"
    assert "Izz(turret)" in error.value.reason
    nothing = estimate | {"axes": {}}
    with pytest.raises(BadInput, match="contains no identified parameters"):
        started_from(robot, nothing, "nothing")


# two do not show a hose
POSES = np.array([[0.0, -0.8, 0.3, 0, 0, 0], [0.0, 0.9, 0.9, 0, 0, 0], [0.0, 0.1, -0.4, 0, 0, 0]])
BLOCKS = ("forward_slow", "backward_slow", "forward_fast")


def sweeps_of(joint: str, coulomb: float, seed: int) -> list[Sweep]:
    return swept(joint, POSES, {Term("coulomb_friction"): (coulomb,)}, seed=seed, blocks=BLOCKS)


@pytest.mark.parametrize("seed", [3, 4])
def test_a_known_effect_that_has_changed_is_told_and_one_that_has_not_is_right(seed: int) -> None:
    sweeps = sweeps_of("joint_2", 120.0, seed)

    def with_known(coulomb: float, std: float) -> Mapping[str, Any]:
        known = {"coulomb_friction": {"coulomb": Parameter(coulomb, std, "N m")}}
        found: Any = axis_document(diagnose_axis(max100(), "joint_2", sweeps, known=known, twin=False)).as_json()
        assert (found["verdict"], found["effects"]) == ("none", [])
        assert ("the model is right" in found["summary"]) == (found["changes"] == [])
        return found

    found = with_known(40.0, 0.2)
    (change,) = found["changes"]
    assert (change["effect"], change["parameter"], change["model"]["value"]) == ("coulomb_friction", "coulomb", 40.0)
    assert abs(change["now"]["value"] - 120.0) < 3 * change["now"]["std"]
    assert "Coulomb friction has changed: coulomb is 1" in found["summary"]
    assert ", not 40 N m" in found["summary"]
    assert with_known(120.0, 0.5)["changes"] == []


def test_what_the_axis_cannot_have_is_left_out() -> None:
    """`--known` is about all axes; a motor of which the robot file knows no orders cannot cog."""
    robot = max100()
    axes = tuple(axis.model_copy(update={"cogging_orders": ()}) for axis in robot.axes)
    smooth = replace(robot, description=robot.description.model_copy(update={"axes": axes}))
    found = diagnose_axis(smooth, "joint_1", sweeps_of("joint_1", 60.0, 6), known={"cogging_torque": {}}, twin=False)
    assert ([effect.name for effect in found.effects], found.known) == (["coulomb_friction"], ())
    assert "cogging_torque" not in found.untestable


def test_all_effects_may_be_known() -> None:
    sweeps, known = sweeps_of("joint_2", 60.0, 7), dict[str, dict[str, Parameter]]((name, {}) for name in CATALOGUE)
    assert diagnose_axis(max100(), "joint_2", sweeps, known=known, twin=False).effects == ()
