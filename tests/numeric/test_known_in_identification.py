"""What a known effect costs J, and what is left of that when the estimate knows it; 10 times less torque noise.

What the estimate is told is one standard deviation off the truth, as a diagnosis would be.
"""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from service.identification.axis.known_effects import KnownEffects
from service.identification.estimates.estimate import RobotEstimate, identify
from simulator import Scenario
from simulator.scenario import DriveTrain, Friction, Hose
from tests.numeric.campaign import AXES, SimulatedCampaign, measure_at, scenario_named
from tests.unit.service.identification.known import Parameters, known

POSES, SEED = 16, 71
BOUND = 1e-3  # of J: what may be left as a bias of an axis, where its standard deviation is no larger
Change = Callable[[DriveTrain], DriveTrain]


def scenario(change: Change = lambda train: train, **measurement: float) -> Scenario:
    full = scenario_named("max100-full")
    quiet = {"effort_noise": 0.0002, "effort_resolution": 0.0} | measurement
    axes = {joint: axis.model_copy(update={"train": change(axis.train)}) for joint, axis in full.axes.items()}
    return full.model_copy(update={"axes": axes, "measurement": full.measurement.model_copy(update=quiet)})


def rubbed(train: DriveTrain, **friction: object) -> DriveTrain:
    return train.model_copy(update={"motor_friction": train.motor_friction.model_copy(update=friction)})


def measured(machine: Scenario, seed: int = SEED) -> SimulatedCampaign:
    rng = np.random.default_rng(SEED)
    poses = np.zeros((POSES, 6))
    poses[:, 1], poses[:, 2] = rng.uniform(-1.2, 1.2, POSES), rng.uniform(-2.0, 1.2, POSES)
    return measure_at(machine, seed, poses)


def told(machine: Scenario, effect: Callable[[Friction], dict[str, Parameters]]) -> KnownEffects:
    effects: dict[str, Any] = {joint: effect(machine.axes[joint].train.motor_friction) for joint in AXES}
    return known(**effects)


def near(value: float, part: float) -> tuple[float, float]:
    """A value that is one standard deviation, `part` of it, too large; and that standard deviation."""
    return value * (1 + part), abs(value) * part


def bias(estimate: RobotEstimate, campaign: SimulatedCampaign) -> dict[str, tuple[float, float, float]]:
    """By joint the mean error of J, its typical standard deviation, and RMS error over standard deviation."""
    found = {}
    for axis in estimate.axes:
        truth = campaign.truth(axis.joint)
        error, std = axis.values / truth - 1, np.array([sweep.std for sweep in axis.sweeps]) / truth
        found[axis.joint] = float(error.mean()), float(std.mean()), float(np.sqrt(np.mean((error / std) ** 2)))
    return found


def compare(machine: Scenario, effects: KnownEffects) -> tuple[dict[str, tuple[float, float, float]], ...]:
    campaign = measured(machine)
    spectra = campaign.spectra
    without, with_them = (bias(identify(campaign.robot, spectra, known=one), campaign) for one in (None, effects))
    for joint in AXES:
        print(
            f"{joint}: J off by {100 * without[joint][0]:+.3f} % without, {100 * with_them[joint][0]:+.3f} % with, "
            f"std {100 * with_them[joint][1]:.3f} %, {with_them[joint][2]:.2f} std"
        )
    return without, with_them


def worst(found: dict[str, tuple[float, float, float]]) -> float:
    return max(abs(mean) for mean, _, _ in found.values())


@pytest.mark.parametrize("seed", [72, 73])
def test_in_the_usual_noise_a_known_delay_moves_no_inertia(seed: int) -> None:
    """Against the same machine in the same noise without delay, axis by axis."""
    full = scenario_named("max100-full")
    late = full.model_copy(update={"measurement": full.measurement.model_copy(update={"effort_delay": 1.3e-3})})
    effects = told(late, lambda _: {"measurement_delay": {"delay": (1.32e-3, 2e-5)}})
    prompt_, delayed = measured(full, seed), measured(late, seed)
    sound = bias(identify(prompt_.robot, prompt_.spectra), prompt_)
    spectra = delayed.spectra
    moved = {
        name: {joint: found[joint][0] - sound[joint][0] for joint in AXES}
        for name, known_ in (("without", None), ("with", effects))
        for found in [bias(identify(delayed.robot, spectra, known=known_), delayed)]
    }
    for name, of in moved.items():
        print(f"seed {seed}, {name}: J moved by " + ", ".join(f"{100 * shift:+.3f} %" for shift in of.values()))
    assert max(map(abs, moved["without"].values())) > 4e-3
    assert max(map(abs, moved["with"].values())) < BOUND


def test_friction_that_is_known_to_grow_with_the_load_costs_no_inertia_or_is_told_as_doubt() -> None:
    machine = scenario(lambda train: rubbed(train, load_dependence=0.05))

    def effect(friction: Friction) -> dict[str, Parameters]:
        return {
            "load_dependent_friction": {"coulomb": near(friction.coulomb, 0.02), "load_dependence": near(0.05, 0.02)}
        }

    without, with_it = compare(machine, told(machine, effect))
    assert worst(without) > 0.03
    for joint in AXES:
        mean, std, z = with_it[joint]
        assert z < 2.0
        # no gravity about the first axis: the load's torque turns with every sine
        assert abs(mean) < 2 * std if joint == "joint_1" else abs(mean) < 0.01


def test_a_known_hose_costs_no_inertia() -> None:
    machine = scenario(lambda train: train.model_copy(update={"hose": Hose(stiffness=600.0, rest=0.1)}))
    effects = told(machine, lambda _: {"hose_spring": {"stiffness": near(600.0, 0.02)}})
    without, with_it = compare(machine, effects)
    assert worst(without) > 2 * BOUND
    assert all(abs(mean) < max(BOUND, 2 * std) for mean, std, _ in with_it.values())


def test_a_soft_gear_that_is_known_is_measured_in_one_pose() -> None:
    """Locked rotor near the lines: one sweep alone cannot tell the spring from the load. Noise as usual."""
    stiffness = 1.5e5

    def soft(train: DriveTrain) -> DriveTrain:
        assert train.spring is not None
        spring = train.spring.model_copy(update={"stiffness": stiffness, "damping": 1e-3 * stiffness})
        return train.model_copy(update={"spring": spring})

    machine = scenario(soft, effort_noise=0.002)
    told_of = {"compliance": near(1 / stiffness, 0.01), "damping_time": near(1e-3, 0.05), "ratio": (1.0, 0.001)}
    effects = known(joint_1={"joint_elasticity": told_of})
    poses = np.zeros((1, 6))
    poses[0, 1:3] = 0.4, -0.8
    found: dict[str, list[tuple[float, float, float]]] = {"without": [], "with": []}
    for seed in range(80, 84):
        campaign = measure_at(machine, seed, poses, axes=("joint_1",))
        for name, given in (("without", None), ("with", effects)):
            found[name].append(bias(identify(campaign.robot, campaign.spectra, known=given), campaign)["joint_1"])
            print(f"soft gear, one sweep, seed {seed}, {name}: J off by {100 * found[name][-1][0]:+.2f} %")
    assert min(std for _, std, _ in found["without"]) > 0.1
    assert max(std for _, std, _ in found["with"]) < 0.02
    assert np.mean([z**2 for _, _, z in found["with"]]) < 4
