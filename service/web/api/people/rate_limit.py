"""Rate limit of wrong keys per address. Pure: the caller passes the time.

It is impossible to guess 32 random bytes, but each attempt costs a database query and an audit entry. Both tables are
bounded: the entry with the oldest last attempt is removed first.
"""

from collections import OrderedDict, deque
from dataclasses import dataclass
from ipaddress import IPv6Address, ip_address

WINDOW = 60.0  # s
MOST = 1000  # addresses, and keys that were accepted

_NETWORK = 64  # bits of an IPv6 address that its owner cannot choose


@dataclass(slots=True)
class _Attempts:
    """Times of the last wrong keys, s; `reported`: the refusal after them is already in the audit."""

    times: deque[float]
    reported: bool = False


class Guesses:
    """Counts wrong keys. `most`: per address within a minute; the next one waits. A time `now` is in s, monotonic."""

    def __init__(self, most: int) -> None:
        self._most = most
        self._wrong: OrderedDict[str, _Attempts] = OrderedDict()
        self._opened: OrderedDict[str, None] = OrderedDict()

    def wait(self, address: str, key_sha256: str | None, now: float) -> float:
        """Time until this key from this address is checked, s; 0: now. A key that was accepted before is always
        checked: wrong keys of others behind the same proxy do not lock out its owner."""
        found = self._wrong.get(_place(address))
        if found is None or len(found.times) < self._most or key_sha256 in self._opened:
            return 0.0
        return max(0.0, found.times[0] + WINDOW - now)

    def __len__(self) -> int:
        """Number of addresses and keys in the tables."""
        return len(self._wrong) + len(self._opened)

    def first_refusal(self, address: str) -> bool:
        """Whether this is the first refusal since the last checked attempt: only this one is written to the audit."""
        found = self._wrong.get(_place(address))
        first = found is not None and not found.reported
        if found is not None:
            found.reported = True
        return first

    def wrong(self, address: str, now: float) -> None:
        """Count a key that was checked and is wrong."""
        place = _place(address)
        found = self._wrong.setdefault(place, _Attempts(deque(maxlen=self._most)))
        found.times.append(now)
        found.reported = False
        self._wrong.move_to_end(place)
        if len(self._wrong) > MOST:
            self._wrong.popitem(last=False)

    def opened(self, key_sha256: str) -> None:
        """Remember a key that was checked and accepted."""
        self._opened[key_sha256] = None
        self._opened.move_to_end(key_sha256)
        if len(self._opened) > MOST:
            self._opened.popitem(last=False)


def _place(address: str) -> str:
    """The network of an IPv6 address: its owner has 2^64 addresses. An IPv4 address itself."""
    try:
        found = ip_address(address)
    except ValueError:  # of a socket without address
        return address
    if isinstance(found, IPv6Address):
        return str(found.ipv4_mapped or int(found) >> _NETWORK)
    return str(found)
