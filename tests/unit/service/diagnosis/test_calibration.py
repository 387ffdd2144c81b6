"""The torque gain from a known mass: exact on set-points followed exactly, whatever friction did in between."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from service import BadInput
from service.diagnosis import axis_document, diagnose_axis
from service.diagnosis.fit.calibration import Weighed, corrected, is_decided, is_wrong, weighed_gain
from service.diagnosis.fit.fitted import Parameter
from service.diagnosis.rows.rigid import nominal_load
from service.diagnosis.rows.signals import tracks
from service.diagnosis.sensitivity import expected
from service.identification.design.diagnosis_sweeps import DesignedSweep, full_design
from service.identification.estimates.torque_gain import KnownMass
from service.model import Robot, Sweep
from tests.unit.service.diagnosis.following import SLOW, carrying, known_to

pytestmark = pytest.mark.slow

POSES = np.array([[0.0, -0.8, 0.3, 0, 0, 0], [0.0, 0.0, -0.5, 0, 0, 0], [0.0, 0.9, 0.9, 0, 0, 0]])
MASS = KnownMass(30.0, (0.15, 0.0, 0.0))
TIGHT = 0.003  # of inertia and gravity: how well CAD knows the robot


def measured(
    robot: Robot,
    joint: str,
    designed: tuple[DesignedSweep, ...],
    *,
    gain: float,
    mass: KnownMass | None,
    by_load: float,
) -> list[Sweep]:
    """Sweeps as a drive of this gain tells them, on a rigid robot with friction that grows with the load."""
    index = robot.index(joint)
    bare = [expected(one, one.spec.pose[index]) for one in designed]
    motion = tracks(robot, joint, bare)
    carried = 0.0 if mass is None else carrying(mass)(motion)
    load = motion.along(nominal_load(robot, joint, motion.poses) + carried)
    viscous = (robot.axis(joint).viscous_friction or 0.0) * motion.velocity
    effort = gain * (load + by_load * np.abs(load) * motion.direction + viscous)
    signals = {name: getattr(motion, name) for name in ("time", "velocity", "position")} | {"effort": effort}
    return [
        Sweep(
            one.spec.model_copy(update={"sample_rate": motion.rate}),
            replace(one.recording, **{name: signal[k][motion.inside[k]] for name, signal in signals.items()}),
        )
        for k, one in enumerate(bare)
    ]


@pytest.mark.parametrize(("gain", "by_load"), [(1.0, 0.0), (1.04, 0.0), (0.93, 0.1), (1.0, 0.1)])
def test_a_mass_tells_the_gain(gain: float, by_load: float) -> None:
    robot = known_to(TIGHT)
    designed = full_design(robot, "joint_2", POSES, repeats=1, blocks=SLOW, revisit=False)
    bare = measured(robot, "joint_2", designed, gain=gain, mass=None, by_load=by_load)
    weighed = Weighed(MASS, tuple(measured(robot, "joint_2", designed, gain=gain, mass=MASS, by_load=by_load)))
    found = weighed_gain(robot, "joint_2", bare, weighed)
    assert found.gain == pytest.approx(gain, abs=0.004)
    assert found.std < 0.006
    assert is_decided(found)
    assert is_wrong(found) == (gain != 1.0)
    right = corrected(bare, found)[0].recording.effort
    np.testing.assert_allclose(right * found.gain, bare[0].recording.effort)


def test_in_one_direction_a_mass_says_how_little_it_tells() -> None:
    robot, one_side = known_to(TIGHT), POSES[2:]
    designed = full_design(robot, "joint_2", one_side, repeats=1, blocks=SLOW[:1], revisit=False)
    bare = measured(robot, "joint_2", designed, gain=1.0, mass=None, by_load=0.1)
    weighed = Weighed(MASS, tuple(measured(robot, "joint_2", designed, gain=1.0, mass=MASS, by_load=0.1)))
    found = weighed_gain(robot, "joint_2", bare, weighed)
    assert abs(found.gain - 1.0) < 3 * found.std
    assert not is_decided(found)


def noisy(sweeps: list[Sweep]) -> list[Sweep]:
    random = np.random.default_rng(3)
    for sweep in sweeps:
        sweep.recording.effort[:] += random.normal(0, 2.0, len(sweep.recording.time))
    return sweeps


@pytest.mark.parametrize(
    ("poses", "test_mass", "by_load", "again", "said"),
    [(1, 30.0, 0.1, False, "The test mass is to be off."), (3, 0.2, 0.0, True, "take a heavier one")],
)
def test_what_comes_next_says_what_is_to_hang_on_the_flange(
    poses: int, test_mass: float, by_load: float, again: bool, said: str
) -> None:
    robot, payload, center = known_to(TIGHT), 8.0, (0.15, 0.0, 0.0)
    designed = full_design(robot, "joint_2", POSES[:poses], blocks=SLOW, revisit=False)

    def bearing(mass: float) -> list[Sweep]:
        return noisy(measured(robot, "joint_2", designed, gain=1.0, mass=KnownMass(mass, center), by_load=by_load))

    weighed = Weighed(KnownMass(test_mass, center), tuple(bearing(payload + test_mass)))
    wanted = diagnose_axis(robot, "joint_2", bearing(payload), weighed=weighed, twin=False).next_experiment
    assert wanted is not None
    assert (wanted.kind == "test_mass") == again
    assert said in wanted.reason


def with_mass(gain: float, ripple: float = 0.0) -> tuple[list[Sweep], Weighed]:
    """Bare sweeps and weighed ones of a drive of this gain; `ripple`, N m, is a square wave over the position."""
    robot = known_to(TIGHT)
    designed = full_design(robot, "joint_2", POSES, blocks=SLOW, revisit=False)

    def told(mass: KnownMass | None) -> list[Sweep]:
        sweeps = noisy(measured(robot, "joint_2", designed, gain=gain, mass=mass, by_load=0.0))
        for sweep in sweeps:
            away = sweep.recording.position - sweep.spec.pose[1]
            sweep.recording.effort[:] += gain * ripple * np.sign(np.sin(away**3 * 2e6))
        return sweeps

    return told(None), Weighed(MASS, tuple(told(MASS)))


@pytest.mark.parametrize(("ripple", "verdict"), [(0.0, "named"), (60.0, "unknown")])
def test_a_mass_tells_the_gain_also_beside_what_nobody_knows(ripple: float, verdict: str) -> None:
    """What it explains is a gap of the effort as it was told."""
    bare, weighed = with_mass(1.15, ripple)
    found: Any = axis_document(diagnose_axis(known_to(TIGHT), "joint_2", bare, weighed=weighed, twin=False)).as_json()
    assert (found["verdict"], [effect["effect"] for effect in found["effects"]]) == (verdict, ["torque_constant_error"])
    assert found["effects"][0]["parameters"]["gain_error"]["value"] == pytest.approx(0.15, abs=0.01)
    apart = found["summary"].startswith("joint_2: torque constant error apart, there is a gap of ")
    assert apart == (found["gap"]["after_rms"] > 0.1 * found["gap"]["before_rms"]) == (verdict == "unknown")


@pytest.mark.parametrize(("gain", "changes"), [(1.15, 0), (1.0, 1)])
def test_a_gain_that_the_model_has_is_weighed_too(gain: float, changes: int) -> None:
    bare, weighed = with_mass(gain)
    known = {"torque_constant_error": {"gain_error": Parameter(0.15, 0.005, "")}}
    told = diagnose_axis(known_to(TIGHT), "joint_2", bare, known=known, weighed=weighed, twin=False)
    found: Any = axis_document(told).as_json()
    assert (found["verdict"], found["effects"]) == ("none", [])
    (gained,) = found["known"]
    assert gained["parameters"]["gain_error"]["value"] == pytest.approx(gain - 1, abs=0.01)
    assert len(found["changes"]) == changes


def test_a_gain_that_the_model_has_is_held_until_it_is_weighed_again() -> None:
    """What pulls 3 % less than CAD says is no other gain."""
    bare, _ = with_mass(1.15 * 0.97)
    known = {"torque_constant_error": {"gain_error": Parameter(0.15, 0.005, "")}}
    found: Any = axis_document(diagnose_axis(known_to(TIGHT), "joint_2", bare, known=known, twin=False)).as_json()
    assert found["known"][0]["parameters"]["gain_error"] == {"value": pytest.approx(0.15), "std": 0.005, "unit": ""}
    assert (found["changes"], found["fit"]["torques"]) == ([], "true")
    assert "torque_constant_error" not in found["candidates"]
    assert found["verdict"] in ("ambiguous", "named")


def test_bad_masses_and_sweeps_are_refused() -> None:
    robot = known_to(TIGHT)
    designed = full_design(robot, "joint_2", POSES[:1], repeats=1, blocks=SLOW, revisit=False)
    sweeps = measured(robot, "joint_2", designed, gain=1.0, mass=None, by_load=0.0)
    with pytest.raises(BadInput, match=r"mass: 0.0 kg is not above 0"):
        weighed_gain(robot, "joint_2", sweeps, Weighed(KnownMass(0.0, (0.1, 0, 0)), tuple(sweeps)))
    with pytest.raises(BadInput, match="joint_2: has no sweep that was run both without and with the test mass"):
        weighed_gain(robot, "joint_2", sweeps[:1], Weighed(MASS, tuple(sweeps[1:])))
