"""Number arrays in the control's XML: doubles, most significant byte first, as words of 32 bits in base 85.

A word consists of five of 85 characters, most significant first; a point is a word of zero. White space is ignored.
"""

import numpy as np
from numpy.typing import NDArray

from service.model.errors import BadInput

Array = NDArray[np.float64]

ALPHABET = b"0123456789abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ!#$`()*+-/:;=?@[]^_{|}~"
HUGE = 1e15  # larger than any measured quantity, in each unit of the control
_FOREIGN = 255
_DIGITS = np.full(256, _FOREIGN, dtype=np.uint8)
_DIGITS[np.frombuffer(ALPHABET, dtype=np.uint8)] = np.arange(85, dtype=np.uint8)
_POWERS = 85 ** np.arange(4, -1, -1, dtype=np.uint64)


def decode(text: str, place: str) -> Array:
    """Doubles (n,) of a text; BadInput at `place` if it is truncated, in another format, or has non-finite numbers."""
    words = "".join(text.split()).split(".")
    if any(len(run) % 5 for run in words):
        raise BadInput(
            place, "base-85 data are incomplete: the number of characters between two points is not a multiple of 5"
        )
    digits = _DIGITS[np.frombuffer("00000".join(words).encode("latin-1", "replace"), dtype=np.uint8)]
    if (digits == _FOREIGN).any():
        raise BadInput(place, "has a character that is not of the control's base 85")
    values = digits.reshape(-1, 5).astype(np.uint64) @ _POWERS
    if len(values) % 2 or (values >= 2**32).any():
        raise BadInput(place, f"{len(values)} words of base 85 are not whole doubles")
    numbers = np.frombuffer(values.astype(">u4").tobytes(), dtype=">f8").astype(np.float64)
    sensible = np.abs(numbers) < HUGE  # False for NaN
    if not sensible.all():
        raise BadInput(place, f"number {int(np.flatnonzero(~sensible)[0])} is NaN, or not below {HUGE:g}")
    return numbers
