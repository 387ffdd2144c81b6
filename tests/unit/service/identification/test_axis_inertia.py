import numpy as np
import pytest

from service.identification.axis.drive_train import TwoMassTrain, impedance, paper_inertia

TRAIN = TwoMassTrain(60.0, 140.0, 70.0, 1.4e-6, 1.2e-3)


def test_two_mass_impedance_by_hand() -> None:
    # the form of the text books: Z = s Jm + mu_m + Zs Zl / (Zs + Zl), Zs = d + k / s
    frequency = np.array([1.0, 2.0, 5.0])
    s = 2j * np.pi * frequency
    stiffness = 1 / TRAIN.compliance
    spring = TRAIN.damping_time * stiffness + stiffness / s
    load = s * 500.0 + TRAIN.load_friction + 900.0 / s
    expected = s * TRAIN.motor_inertia + TRAIN.motor_friction + spring * load / (spring + load)
    np.testing.assert_allclose(impedance(frequency, TRAIN, 500.0, 900.0).total, expected, rtol=1e-12)


def test_locked_rotor_frequency() -> None:
    train = TwoMassTrain(1.0, 0.0, 0.0, 1 / 4e5, 0.0)
    assert train.locked_rotor_frequency(100.0) == pytest.approx(np.sqrt(4e5 / 100.0) / (2 * np.pi))
    assert TwoMassTrain(1.0, 0.0, 0.0, 0.0, 0.0).locked_rotor_frequency(100.0) == np.inf
    assert train.locked_rotor_frequency(-0.2) == np.inf  # noise may make a load vanish


def test_paper_formula_removes_friction_of_a_rigid_axis_exactly() -> None:
    for frequency in (2.0, 3.0, 4.0, 5.0):
        response = 300.0 + 2j * np.pi * frequency * 200.0
        assert paper_inertia(frequency, response) == pytest.approx(200.0, rel=1e-12)


@pytest.mark.parametrize(("frequency", "percent"), [(2.0, 1.9), (3.0, 4.3), (4.0, 8.0), (5.0, 13.5)])
def test_paper_formula_errs_with_elasticity(frequency: float, percent: float) -> None:
    # locked rotor at 12 Hz, load 2/3 of the inertia: the bias grows with (f/12 Hz)^2
    load, motor = 133.0, 67.0
    train = TwoMassTrain(motor, 0.0, 0.0, 1 / (load * (2 * np.pi * 12.0) ** 2), 0.0)
    response = complex(impedance(np.array([frequency]), train, load, 0.0).total[0])
    error = 100 * (paper_inertia(frequency, response) / (load + motor) - 1)
    assert error == pytest.approx(percent, rel=0.05)
