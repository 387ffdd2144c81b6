"""The plant against closed formulas: frequency response of rigid and two-mass drive trains, gravity, friction.

Z = Gamma/Omega. Rigid: Z = iwJ + mu. Two masses: Z = iwJm + mu_m + Zs Zl/(Zs + Zl), Zs = d + k/(iw), Zl = iwJl + mu_l.
"""

from pathlib import Path

import numpy as np
import pytest

from simulator import Measurement, Scenario, SweepRun, load_scenario, run_sweeps, true_inertia
from simulator.rigid_body import RigidBody

SCENARIOS = Path(__file__).parents[2] / "config" / "scenarios"
FREQUENCIES = (2.0, 3.0, 4.0, 5.0)
ARM = ((-0.5, -1.0), (0.6, -0.2), (1.2, -1.4))


def without_noise_gravity_and_cogging(name: str) -> Scenario:
    """Gravity changes along the way, which is no linear relation of torque and speed: it has its own test below."""
    scenario = load_scenario(SCENARIOS / f"max100-{name}.yaml")
    axes = {
        joint: axis.model_copy(update={"train": axis.train.model_copy(update={"cogging": ()})})
        for joint, axis in scenario.axes.items()
    }
    weightless = scenario.robot.model_copy(update={"gravity": (0.0, 0.0, 0.0)})
    return scenario.model_copy(update={"axes": axes, "robot": weightless, "measurement": Measurement()})


def sweeps() -> list[SweepRun]:
    sines = tuple((f, 0.0021, 0.5 * f * f) for f in FREQUENCIES)
    return [
        SweepRun(f"joint_{k}", (0.0, *arm, 0.0, 0.0, 0.0), 0.0105, sines, 1.0, 5, 0.5, 1.5)
        for k in (1, 2, 3)
        for arm in ARM
    ]


def impedance(columns: dict[str, np.ndarray], frequency: float) -> complex:
    window = slice(2000, 7000)
    wave = np.exp(-2j * np.pi * frequency * columns["time"][window])
    return complex((columns["effort"][window] @ wave) / (columns["velocity"][window] @ wave))


def test_rigid_frequency_response() -> None:
    scenario, runs = without_noise_gravity_and_cogging("rigid"), sweeps()
    for run, columns in zip(runs, run_sweeps(scenario, runs, seed=1), strict=True):
        train = scenario.axes[run.axis].train
        viscous = train.motor_friction.viscous + train.load_friction.viscous
        inertia = true_inertia(scenario, run.axis, [run.pose])[0]
        for frequency in FREQUENCIES:
            found = impedance(columns, frequency)
            assert found.imag == pytest.approx(2 * np.pi * frequency * inertia, rel=1e-5)
            assert found.real == pytest.approx(viscous, abs=1e-5 * abs(found))  # no delay of torque against speed


def test_two_mass_frequency_response() -> None:
    scenario, runs = without_noise_gravity_and_cogging("full"), sweeps()
    for run, columns in zip(runs, run_sweeps(scenario, runs, seed=1), strict=True):
        train = scenario.axes[run.axis].train
        assert train.spring is not None
        motor = train.motor_inertia * scenario.nominal(run.axis).gear_ratio ** 2
        load = true_inertia(scenario, run.axis, [run.pose])[0] - motor
        for frequency in FREQUENCIES:
            iw = 2j * np.pi * frequency
            spring = train.spring.damping + train.spring.stiffness / iw
            arm = iw * load + train.load_friction.viscous
            expected = iw * motor + train.motor_friction.viscous + spring * arm / (spring + arm)
            found = impedance(columns, frequency)
            assert found.imag == pytest.approx(expected.imag, rel=1e-3)
            assert found.real == pytest.approx(expected.real, abs=1e-3 * abs(expected))


def test_gravity_and_coulomb_at_constant_speed() -> None:
    """Rigid, no sines: effort = mu v + Fc + gravity(q) at every sample."""
    scenario = load_scenario(SCENARIOS / "max100-rigid.yaml")
    pose = (0.0, 0.6, -0.2, 0.0, 0.0, 0.0)
    run = SweepRun("joint_2", pose, -0.02, (), 1.0, 2, 0.5, 2.0)
    (columns,) = run_sweeps(scenario, [run], seed=1)
    gravity = RigidBody(scenario).gravity(1, pose)
    window = slice(2500, 4500)
    held = np.array([gravity.at(q) for q in columns["position"][window]])
    velocity = columns["velocity"][window]
    np.testing.assert_allclose(velocity, -0.02, rtol=5e-3)  # gravity grows all the way, the integrator lags
    np.testing.assert_allclose(columns["effort"][window], held + 225.0 * velocity - 155.0, atol=0.01)


def test_locked_rotor_frequency_of_axis_1_falls_as_the_arm_stretches() -> None:
    scenario = load_scenario(SCENARIOS / "max100-full.yaml")
    train = scenario.axes["joint_1"].train
    assert train.spring is not None
    motor = train.motor_inertia * scenario.nominal("joint_1").gear_ratio ** 2
    folded, stretched = true_inertia(scenario, "joint_1", [[0, -0.3, -1.1, 0, 0, 0], [0, 1.2, -1.1, 0, 0, 0]]) - motor
    assert np.sqrt(train.spring.stiffness / folded) / (2 * np.pi) == pytest.approx(12, abs=1.5)
    assert np.sqrt(train.spring.stiffness / stretched) / (2 * np.pi) == pytest.approx(5, abs=0.6)
