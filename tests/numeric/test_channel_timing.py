"""Delay and smoothing of the channels, measured on simulated calibration sweeps, and what they do to J.

`pytest tests/numeric/test_channel_timing.py -s` prints the figures.
"""

import numpy as np
import pytest

from drivers.ports import ChannelTiming
from service import BadInput
from service.identification.axis.channel_timing import ChannelLags, channel_lags
from service.identification.design.diagnosis_sweeps import DesignedSweep
from service.identification.design.excitation import Sines, design_sweep
from service.identification.estimates.estimate import identify
from service.identification.model import inertia_rows, lock
from service.identification.spectra.frequency_response import spectrum
from service.model import Robot, Sweep
from service.model.channels import align
from simulator import Scenario, true_inertia
from tests.numeric.campaign import AXES, max100, run_plan, scenario_named, spec_of

CALIBRATION = (2.0, 3.0, 4.0, 5.0, 40.0, 50.0, 60.0, 70.0, 80.0, 90.0)
MICRO = 1e6
CASES = {
    "none": {},
    "delay": {"effort_delay": 0.5e-3},
    "effort": {"effort_delay": 1e-3, "effort_smoothing": 2e-3},
    "both": {
        "effort_delay": 0.25e-3,
        "effort_smoothing": 1e-3,
        "velocity_delay": 0.5e-3,
        "velocity_smoothing": 1e-3,
    },
}


def lagging(case: str) -> Scenario:
    scenario = scenario_named("max100-full")
    return scenario.model_copy(update={"measurement": scenario.measurement.model_copy(update=CASES[case])})


def swept(scenario: Scenario, robot: Robot, joint: str, lines: tuple[float, ...], poses: int, seed: int) -> list[Sweep]:
    """Sweeps of one axis in random poses, in closed loop, traced at 1 kHz."""
    rng = np.random.default_rng(seed)
    grid = np.zeros((poses, 6))
    grid[:, 1], grid[:, 2] = rng.uniform(-0.8, 0.8, poses), rng.uniform(-1.0, 1.0, poses)
    loads = inertia_rows(lock(robot.chain, {3: 0.0, 4: 0.0, 5: 0.0}), robot.index(joint), grid[:, :3])
    loads = loads @ lock(robot.chain, {3: 0.0, 4: 0.0, 5: 0.0}).inertial.ravel()
    designed: list[DesignedSweep] = []
    for number, (pose, load) in enumerate(zip(grid, loads, strict=True), 1):
        sweep = design_sweep(robot, joint, pose, load_inertia=float(load), lines=lines, velocity_limit=0.1)
        designed.append(DesignedSweep(spec_of(sweep, number, joint, pose), sweep.ramp, sweep.settle))
    return run_plan(scenario, designed, seed, direct_encoder=True)


def calibrated(case: str, joint: str, seed: int) -> ChannelLags:
    robot = max100()
    return channel_lags(robot, joint, swept(lagging(case), robot, joint, CALIBRATION, poses=4, seed=seed))


@pytest.mark.parametrize(
    ("case", "joint", "seed"),
    [(case, joint, 3 * n + k) for n, case in enumerate(CASES) for k, joint in enumerate(AXES)],
)
def test_lags_are_found_within_their_uncertainty(case: str, joint: str, seed: int) -> None:
    lags = calibrated(case, joint, seed)
    for name, lag in (("effort", lags.effort), ("velocity", lags.velocity)):
        delay, smoothing = (CASES[case].get(f"{name}_{kind}", 0.0) for kind in ("delay", "smoothing"))
        told = [("total", lag.total, lag.total_std, delay + smoothing)]
        assert lag.apart == (smoothing > 0)
        if lag.apart:
            told += [
                ("delay", lag.delay, lag.delay_std, delay),
                ("smoothing", lag.smoothing, lag.smoothing_std, smoothing),
            ]
        else:
            assert (lag.delay, lag.smoothing) == (lag.total, 0.0)
        for what, value, std, truth in told:
            deviation = (value - truth) / std
            print(
                f"{case} {joint} seed {seed} {name} {what}: {MICRO * value:.1f} +- {MICRO * std:.1f} us, "
                f"truth {MICRO * truth:.0f}, {deviation:+.1f} sigma"
            )
            assert abs(deviation) < 3
            assert std < 100e-6


@pytest.mark.parametrize("joint", AXES)
def test_what_the_correction_does_to_the_inertia(joint: str) -> None:
    """With delay and smoothing, uncorrected and corrected by what calibration sweeps of the same drive gave."""
    robot, scenario = max100(), lagging("effort")
    lags = calibrated("effort", joint, seed=3)
    timing = ChannelTiming(
        effort_delay=lags.effort.delay,
        effort_smoothing=lags.effort.smoothing,
        velocity_delay=lags.velocity.delay,
        velocity_smoothing=lags.velocity.smoothing,
    )
    sweeps = swept(scenario, robot, joint, Sines.lines[:3], poses=12, seed=11)
    truth = true_inertia(scenario, joint, np.array([sweep.spec.pose for sweep in sweeps]))

    def errors(corrected: bool) -> tuple[np.ndarray, np.ndarray]:
        """Relative errors of J in percent, and standard deviations of the errors stated."""
        spectra = []
        for sweep in sweeps:
            recording = align(sweep.recording, timing) if corrected else sweep.recording
            spectra.append(spectrum(robot, Sweep(sweep.spec, recording)))
        (axis,) = identify(robot, spectra).axes
        values = np.array([one.value for one in axis.sweeps])
        return 100 * (values / truth - 1), (values - truth) / [one.std for one in axis.sweeps]

    raw, raw_sigma = errors(corrected=False)
    right, right_sigma = errors(corrected=True)
    print(
        f"{joint}: RMS error of J uncorrected {np.sqrt(np.mean(raw**2)):.2f} % "
        f"(mean {raw.mean():+.2f} %, worst {np.abs(raw_sigma).max():.1f} sigma), "
        f"corrected {np.sqrt(np.mean(right**2)):.2f} % "
        f"(mean {right.mean():+.2f} %, worst {np.abs(right_sigma).max():.1f} sigma)"
    )
    assert np.abs(right_sigma).max() < 4
    assert np.sqrt(np.mean(right**2)) < np.sqrt(np.mean(raw**2))


def test_lines_below_the_resonance_show_no_delay() -> None:
    robot = max100()
    sweeps = swept(lagging("none"), robot, "joint_1", (2.0, 3.0, 4.0, 5.0), poses=2, seed=1)
    with pytest.raises(BadInput, match="joint_1: the highest line of 5 Hz is not above the free resonance"):
        channel_lags(robot, "joint_1", sweeps)


def test_an_axis_that_was_not_swept_is_refused() -> None:
    with pytest.raises(BadInput, match="joint_3: has no sweep with sines"):
        channel_lags(max100(), "joint_3", [])
