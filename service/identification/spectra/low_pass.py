r"""One zero-phase low-pass for every signal of a record; derivatives are computed in the frequency domain as well.

    H(f) = erfc((f - cut) / (sqrt(2) ROLL_OFF cut)) / 2,        d^k/dt^k:  (2 pi i f)^k H(f)

The edge is the integral of a Gaussian, so the filter's memory decays like a Gaussian of 1 / (2 pi ROLL_OFF cut) s. Ends
of a record are extended by point reflection, which keeps value and slope: correct if an axis rests at the end,
otherwise wrong by the acceleration within `memory` of the end.
"""

from typing import cast

import numpy as np
from numpy.typing import NDArray
from scipy.fft import next_fast_len
from scipy.special import erfc

from service.identification.spectra.frequency_response import Complex

Array = NDArray[np.float64]

ROLL_OFF = 0.2  # of the cut-off
DEVIATIONS = 4.0  # standard deviations of the Gaussian that are counted as memory


def memory(cut: float) -> float:
    """Length of the filter on either side, s."""
    return DEVIATIONS / (2 * np.pi * ROLL_OFF * cut)


def low_pass(signals: Array, rate: float, cut: float, derivative: int = 0) -> Array:
    """Signals (m, ...) along the first axis, or a derivative of them; `rate` and `cut` in Hz."""
    count = len(signals)
    pad = min(int(np.ceil(2 * memory(cut) * rate)), count - 1)
    more = min(int(next_fast_len(count + 2 * pad, real=True)) - count - pad, count - 1)  # primes are slow
    before = 2 * signals[:1] - signals[pad:0:-1]
    after = 2 * signals[-1:] - signals[-2 : -more - 2 : -1]
    # the mean of the ends is subtracted, so that numbers far from zero lose no digits
    middle = (signals[:1] + signals[-1:]) / 2
    longer = np.concatenate([before, signals, after]) - middle
    frequency = np.fft.rfftfreq(len(longer), 1 / rate)
    gain = cast(Array, erfc((frequency / cut - 1) / (np.sqrt(2) * ROLL_OFF))) / 2
    response = ((2j * np.pi * frequency) ** derivative * gain).reshape(-1, *[1] * (signals.ndim - 1))
    spectrum: Complex = np.fft.rfft(longer, axis=0) * response
    smooth = np.fft.irfft(spectrum, len(longer), axis=0)[pad : pad + count]
    return smooth + middle if derivative == 0 else smooth
