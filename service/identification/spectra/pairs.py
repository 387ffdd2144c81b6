"""Complex numbers as pairs [re, im], as they stand in files; they survive exactly."""

import numpy as np
from numpy.typing import NDArray

from service.results.identified.spectrum import Pairs

Complex = NDArray[np.complex128]


def pairs(values: Complex) -> Pairs:
    """(n,) -> n pairs."""
    return [[value.real, value.imag] for value in values.tolist()]


def from_pairs(told: Pairs) -> Complex:
    """The inverse: (n,)."""
    return np.array([complex(re, im) for re, im in told], dtype=np.complex128)
