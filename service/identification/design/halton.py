"""Quasi-random points that fill a box evenly: Halton's sequence, dimension k by the digits of n in the kth prime.

The value of n = sum_i d_i p^i is its digits mirrored at the point, sum_i d_i p^-(i+1) (J. H. Halton, Numerische
Mathematik 2, 1960). SciPy's `qmc.Halton` without scrambling gives the same numbers, but its import takes half a second
in every process that plans or identifies.
"""

from itertools import count, islice

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def spread_evenly(number: int, lower: Array, upper: Array) -> Array:
    """`number` points (number, n) of the box from `lower` to `upper` (n,), in their units; the first is `lower`."""
    unit = np.stack([_mirrored(number, prime) for prime in _primes(len(lower))], axis=1)
    return unit * (upper - lower) + lower


def _mirrored(number: int, base: int) -> Array:
    """Of 0 to `number` - 1, in [0, 1)."""
    values, rest, place = np.zeros(number), np.arange(number), 1.0 / base
    while rest.any():
        rest, digit = np.divmod(rest, base)
        values += digit * place
        place /= base
    return values


def _primes(number: int) -> tuple[int, ...]:
    return tuple(islice((n for n in count(2) if all(n % k for k in range(2, n))), number))
