"""The initial analysis on simulated noise runs against the truth of their scenario.

`pytest tests/numeric/test_initial_analysis.py -s` prints the figures. Tolerances: locked-rotor frequency by the fit
0.5 % (1 % on axis 3, light with strong cogging), by the asymptotes one spacing of the lines; every stated standard
deviation is to hold within a factor of 3.
"""

import numpy as np
import pytest

from service.identification.axis.ideal_frequency import nearest_line
from tests.numeric.noise_campaign import SimulatedAnalysis, measure_noise

NAMES = ("motor inertia", "motor friction", "load friction", "compliance", "damping time")


@pytest.fixture(scope="module", params=["joint_1", "joint_2", "joint_3"])
def simulated(request: pytest.FixtureRequest) -> SimulatedAnalysis:
    return measure_noise("max100-full", request.param, seed=5)


def test_drive_train_and_frequencies(simulated: SimulatedAnalysis) -> None:
    analysis, truth = simulated.analysis, simulated.true_train
    off = (analysis.mean - truth) / np.sqrt(np.diag(analysis.covariance))
    for name, value, true, sigmas in zip(NAMES, analysis.mean, truth, off, strict=True):
        print(f"{simulated.joint} {name}: {value:.5g}, truth {true:.5g}, off by {sigmas:+.2f} standard deviations")
    assert np.abs(off).max() < 3
    assert np.abs(analysis.mean[[0, 3]] / truth[[0, 3]] - 1).max() < 0.01
    assert 0.7 < analysis.chi_squared < 1.4
    friction = truth[1] + truth[2]
    for pose, inertia in zip(analysis.poses, simulated.true_inertia, strict=True):
        resonance = 1 / (2 * np.pi * np.sqrt(truth[3] * (inertia - truth[0])))
        corner = friction / (2 * np.pi * inertia)
        print(
            f"{simulated.joint} J {inertia:.1f}: locked rotor {pose.fit.locked_rotor.value:.3f} +- "
            f"{pose.fit.locked_rotor.std:.3f} Hz (asymptotes {pose.asymptotes.locked_rotor.value:.2f}, truth "
            f"{resonance:.3f}); corner {pose.fit.corner.value:.3f} +- {pose.fit.corner.std:.3f} Hz (asymptotes "
            f"{pose.asymptotes.corner.value:.3f}, truth {corner:.3f}); J {pose.fit.inertia.value:.1f} +- "
            f"{pose.fit.inertia.std:.1f}; median coherence {np.median(pose.response.coherence):.4f}"
        )
        assert abs(pose.fit.locked_rotor.value / resonance - 1) < (0.01 if simulated.joint == "joint_3" else 0.005)
        assert abs(pose.asymptotes.locked_rotor.value - resonance) < 0.625
        assert abs(pose.fit.inertia.value - inertia) < 3 * pose.fit.inertia.std
        assert abs(pose.fit.corner.value - corner) < 3 * pose.fit.corner.std
        assert np.median(pose.response.coherence) > 0.98
        assert pose.fit.sweep_frequency == nearest_line(np.sqrt(resonance * corner))
