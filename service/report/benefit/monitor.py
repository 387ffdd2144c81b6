r"""The smallest external effort that a monitor of the drive torque can distinguish from the error of its model.

The monitor compares measured and predicted effort at each sample. It gives an alarm if they differ by more than L.
False alarms: one in `QUIET_HOURS` h of samples at the drive's rate, that is a probability p = 1 / (3600 QUIET_HOURS
rate) per sample, some 3e-8 at 1 kHz. Minutes of recordings have too few samples for an empirical quantile that far
rate) per sample, about 3e-8 at 1 kHz. Minutes of recordings have too few samples for an empirical quantile at this
probability, so a Gaussian tail is assumed, with the mean m_s and the standard deviation s_s of each sweep:
    mean over s of  Phi(-(L - m_s)/s_s) + Phi(-(L + m_s)/s_s)  =  p

Differences between poses (gravity, friction) are not noise that changes with each sample: one Gaussian over all
poses would multiply them by 5.5 and make the better model look too good. L is never less than the largest recorded
difference. An external effort of L is just detected if there is no other difference. Single samples are assumed
independent, so the requirement is higher than for the filtered monitors of real controls.
"""

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq
from scipy.special import ndtr, ndtri

Array = NDArray[np.float64]

QUIET_HOURS = 8.0  # one shift
TINY = 1e-9  # of the largest difference: standard deviation of a sweep without differences


def alarm_probability(sample_rate: float, quiet_hours: float = QUIET_HOURS) -> float:
    """Probability per sample for one false alarm in `quiet_hours`; `sample_rate` in Hz."""
    return 1.0 / (3600.0 * quiet_hours * sample_rate)


def smallest_effort(means: Array, stds: Array, peak: float, probability: float) -> float:
    """L from means (s,) and standard deviations (s,) of the sweeps and the largest difference recorded; N m (N)."""
    scale = max(float(np.abs(means).max()), float(stds.max()))
    if scale == 0:
        return peak
    spread = np.maximum(stds, TINY * scale)

    def excess(limit: float) -> float:
        tails = ndtr(-(limit - means) / spread) + ndtr(-(limit + means) / spread)
        return float(np.mean(tails)) - probability

    # each sweep alone meets the rate here, so all together do
    enough = float(np.max(np.abs(means) - ndtri(probability / 2) * spread))
    return max(float(brentq(excess, 0.0, 1.01 * enough)), peak)
