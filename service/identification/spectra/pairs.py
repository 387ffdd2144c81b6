"""Complex numbers as pairs [re, im], the exact format of files."""

import numpy as np
from numpy.typing import NDArray

from service.model.results.identified.spectrum import Pairs

Complex = NDArray[np.complex128]


def pairs(values: Complex) -> Pairs:
    """(n,) -> n pairs."""
    return [[value.real, value.imag] for value in values.tolist()]


def from_pairs(values: Pairs) -> Complex:
    """The inverse: (n,)."""
    return np.array([complex(re, im) for re, im in values], dtype=np.complex128)
