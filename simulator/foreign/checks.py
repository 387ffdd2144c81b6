"""Values that CiA 301 and CiA 402 forbid in addition to the limits of an object: option codes and identifiers."""

from simulator.drive.dictionary import Abort, AbortCode
from simulator.foreign.dictionary import ForeignDictionary

NUMBER = 0x7FF
"""The identifier in a COB-ID."""

_OPTIONS = {0x605A: (0, 1, 2, 3, 5, 6, 7), 0x605B: (0, 1), 0x605C: (0, 1), 0x605D: (1, 2), 0x605E: (0, 1, 2, 3)}
_RESTRICTED = ((0x000, 0x07F), (0x101, 0x180), (0x581, 0x5FF), (0x601, 0x67F), (0x6E0, 0x6FF), (0x701, 0x7FF))


def check_options(dictionary: ForeignDictionary) -> None:
    """Refuse option codes that no drive supports, and identifiers of SYNC and EMCY that are reserved."""
    for index in _OPTIONS:
        dictionary.on_download((index, 0), lambda value, index=index: _check_option(index, value))
    dictionary.on_download((0x1005, 0), check_identifier)
    dictionary.on_download((0x1014, 0), lambda value: check_identifier(value & ~(1 << 31)))


def check_identifier(cob_id: int) -> None:
    """Raise `Abort` for any flag, an extended identifier, or one reserved by CiA 301, 7.3.5."""
    if cob_id & ~NUMBER or any(low <= cob_id <= high for low, high in _RESTRICTED):
        raise Abort(AbortCode.VALUE)


def _check_option(index: int, value: int) -> None:
    if value not in _OPTIONS[index]:
        raise Abort(AbortCode.VALUE)
