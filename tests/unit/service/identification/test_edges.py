"""What bundles from elsewhere hold: sweeps without inertia, unknown rotors, a single short period, odd joint ranges."""

import numpy as np
import pytest

from service import BadInput
from service.identification.estimates.estimate import identify
from service.identification.estimation import estimate_document
from service.identification.model import joint_ranges
from service.identification.spectra.frequency_response import Spectrum, spectrum
from service.identification.spectra.time_domain import fit_record
from service.model import Axis, Robot, RobotDescription, Sweep, build_robot, read_chain
from tests.formula_sweep import Turning, by_formula, lines
from tests.unit.service.identification.conftest import URDF

LIFTS = (-1.0, -0.5, 0.1, 0.7, 1.2)


def _sweep(
    number: int, inertia: float, noise: float, frequencies: tuple[float, ...] = (2.0, 3.0, 5.0), **fields: object
) -> Sweep:
    """`lift` by formula: effort = J dv/dt + 200 v + 90, no gravity (`_robot` has none)."""

    def effort(m: Turning) -> np.ndarray:
        disturbed = 90 + np.random.default_rng(number).normal(0, noise, 1500)
        return inertia * m.acceleration + 200 * m.velocity + disturbed

    pose, sines = (0.0, LIFTS[number % len(LIFTS)]), lines(frequencies, 0.004)
    own = {"id": f"{number:04}", "axis": "lift", "pose": pose, "offset_velocity": 0.02, "sines": sines, "periods": 3}
    return by_formula(effort, 3.0, sines, pose[1], **own | fields)


def _robot(**axis: float | None) -> Robot:
    values = {"gear_ratio": 170.0, "rated_effort": 1000.0, "motor_inertia": 0.002, "viscous_friction": 200.0, **axis}
    axes = tuple(Axis.model_validate({"joint": joint, **values}) for joint in ("swing", "lift"))
    return build_robot(RobotDescription(name="pair", urdf="robot.urdf", gravity=(0, 0, 0), axes=axes), URDF)


def _z(robot: Robot, spectra: list[Spectrum], inertia: float) -> np.ndarray:
    return np.array([(sweep.value - inertia) / sweep.std for sweep in identify(robot, spectra).axes[0].sweeps])


@pytest.mark.parametrize("excitation", ["noise", "standstill"])
def test_noise_and_standstill_take_no_part_in_inertia(excitation: str) -> None:
    robot = _robot()
    sines = [spectrum(robot, _sweep(k, 310.0, 2.0)) for k in range(5)]
    other = [
        spectrum(robot, _sweep(k, 80.0, 9.0, (), excitation=excitation, sines=(), period=None, periods=None))
        for k in (5, 6)
    ]
    assert estimate_document(robot, sines + other) == estimate_document(robot, sines)
    nothing = estimate_document(robot, other)
    assert nothing.axes == {}
    assert nothing.base_parameters == ()
    with pytest.raises(BadInput, match="no sweep to identify from"):
        identify(robot, other)


@pytest.mark.parametrize("motor_inertia", [None, 0.0])
def test_an_unknown_rotor_may_outweigh_all_links(motor_inertia: float | None) -> None:
    robot = _robot(motor_inertia=motor_inertia)
    spectra = [spectrum(robot, _sweep(k, 2500.0, 2.0)) for k in range(5)]  # the links: 256
    assert np.abs(_z(robot, spectra, 2500.0)).max() < 4
    motors = estimate_document(robot, spectra).standard_parameters.motor_inertias
    assert motors["Jm(lift)"] > 2000


def test_friction_of_zero_is_friction_unknown() -> None:
    robot = _robot(viscous_friction=0.0)
    assert np.abs(_z(robot, [spectrum(robot, _sweep(k, 310.0, 2.0)) for k in range(5)], 310.0)).max() < 4


@pytest.mark.parametrize("count", [1, 5])
def test_bins_too_few_to_show_the_noise_do_not_promise_precision(count: int) -> None:
    """One period of half a second: three bins for eight unknowns and more. The data sheet's noise stands."""
    robot = _robot()
    sweeps = [_sweep(k, 310.0, 2.0, (2.0, 4.0), period=0.5, periods=1) for k in range(count)]
    axis = identify(robot, [spectrum(robot, sweep) for sweep in sweeps]).axes[0]
    # 0.2 % of 1000 N m on 250 samples of a 4 Hz sine: a lower bound
    bound = 2.0 * np.sqrt(2 / 250) / (2 * np.pi * 4 * 0.004)
    for sweep in axis.sweeps:
        assert sweep.std > bound
        assert abs(sweep.value - 310) < 4 * sweep.std


def test_a_motion_that_leaves_the_inertia_open_is_refused() -> None:
    robot = _robot()
    free = {"excitation": "trajectory", "sines": (), "period": None, "periods": None}
    steady = spectrum(robot, _sweep(1, 310.0, 2.0, (), **free))
    with pytest.raises(BadInput, match="sweep 0001: its motion of 1500 samples does not separate inertia from"):
        fit_record(steady)
    short = spectrum(robot, _sweep(2, 310.0, 2.0, **free, measure_from=2.98))
    with pytest.raises(BadInput, match="sweep 0002: its motion of 10 samples"):
        fit_record(short)


def test_a_free_record_is_transformed_by_the_trapezoidal_rule() -> None:
    robot = _robot()
    sweep = _sweep(1, 310.0, 2.0, excitation="trajectory", sines=(), period=None, periods=None)
    result, time = spectrum(robot, sweep), sweep.recording.time
    for k in (0, 1, 17):
        turning = sweep.recording.effort * np.exp(-2j * np.pi * result.frequency[k] * time)
        assert result.effort[k] == pytest.approx(np.trapezoid(turning, time) / time[-1])


def test_joint_ranges_stay_where_the_joint_is() -> None:
    limits = ((4.0, 8.0), (3.5, 6.0), (-6.28, 6.28))
    text = "".join(
        f'<link name="l{k}"/><joint name="j{k}" type="{kind}"><parent link="{"base" if k == 0 else f"l{k - 1}"}"/>'
        f'<child link="l{k}"/><limit lower="{low}" upper="{high}" velocity="1" effort="1"/></joint>'
        for k, (kind, (low, high)) in enumerate(zip(("prismatic", "revolute", "revolute"), limits, strict=True))
    )
    lower, upper = joint_ranges(read_chain(f'<robot name="r"><link name="base"/>{text}</robot>'))
    assert lower.tolist() == [4.0, 3.5, -np.pi]
    assert upper.tolist() == [8.0, 6.0, np.pi]
