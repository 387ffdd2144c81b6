"""Realisations on the virtual machine: friction that falls with the speed distorts, plain friction does not."""

import numpy as np
import pytest

from service.identification.axis.axis_estimate import AxisDistortion
from service.identification.design.diagnosis_sweeps import DesignedSweep
from service.identification.design.excitation import design_sweep, realisations
from service.identification.estimates.estimate import identify
from service.identification.spectra.frequency_response import spectrum
from simulator import Scenario
from simulator.scenario import Stribeck
from tests.numeric.campaign import max100, run_plan, scenario_named, spec_of

JOINT, POSES, COUNT = "joint_2", 6, 4


def distortion(machine: Scenario) -> AxisDistortion:
    """Of one axis in a few poses."""
    robot, rng = max100(), np.random.default_rng(8)
    designed: list[DesignedSweep] = []
    for number in range(POSES):
        pose = (0.0, *rng.uniform(-1.0, 1.0, 2).tolist(), 0.0, 0.0, 0.0)
        once = design_sweep(robot, JOINT, np.array(pose), load_inertia=250.0, locked_rotor_frequency=12.0)
        for one in realisations(once, COUNT, [number]):
            designed.append(DesignedSweep(spec_of(one, len(designed) + 1, JOINT, pose), one.ramp, one.settle))
    spectra = [spectrum(robot, sweep) for sweep in run_plan(machine, designed, 8, direct_encoder=True)]
    (axis,) = identify(robot, spectra).axes
    assert axis.distortion is not None
    return axis.distortion


@pytest.mark.parametrize("falls", [False, True])
def test_distortion_is_seen_where_friction_falls_with_the_speed(falls: bool) -> None:
    machine = scenario_named("max100-full")
    if falls:
        axis = machine.axes[JOINT]
        friction = axis.train.motor_friction
        law = friction.model_copy(update={"stribeck": Stribeck(extra=0.7 * friction.coulomb, velocity=0.01)})
        train = axis.train.model_copy(update={"motor_friction": law})
        machine = machine.model_copy(update={"axes": machine.axes | {JOINT: axis.model_copy(update={"train": train})}})
    found = distortion(machine)
    ratio = found.distortion / found.noise
    lines = np.isin(found.frequency, (2.0, 3.0, 4.0, 5.0))
    print(f"falls {falls}: distortion over noise at the lines {ratio[lines].round(2)}")
    if falls:
        assert ratio[lines].min() > 2
    else:
        assert ratio[lines].max() < 2  # nothing but chance: a difference of variances, on 18 values
