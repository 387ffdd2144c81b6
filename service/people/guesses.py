"""How often an address may show a key that is not one of the service's. Pure: the caller brings the time.

Nobody guesses 32 random bytes; but each attempt costs a look into the database and a line in the audit. Both tables are
bounded: what was longest without an attempt is forgotten first.
"""

from collections import OrderedDict, deque
from dataclasses import dataclass
from ipaddress import IPv6Address, ip_address

WINDOW = 60.0  # s
MOST = 1000  # addresses, and keys that have opened

_NETWORK = 64  # bits of an IPv6 address that its owner cannot choose


@dataclass(slots=True)
class _Attempts:
    """Times of the last wrong ones, s; `told`: whether the refusal that they brought is in the audit."""

    times: deque[float]
    told: bool = False


class Guesses:
    """Counts wrong keys. `most`: of an address within a minute; one more waits. A time `now` is in s and monotonic."""

    def __init__(self, most: int) -> None:
        self._most = most
        self._wrong: OrderedDict[str, _Attempts] = OrderedDict()
        self._opened: OrderedDict[str, None] = OrderedDict()

    def wait(self, address: str, key_sha256: str | None, now: float) -> float:
        """s until this key from there is looked at; 0: now. One that has opened before is looked at in any case: who
        works here is not locked out by who guesses beside him, behind the same proxy."""
        found = self._wrong.get(_place(address))
        if found is None or len(found.times) < self._most or key_sha256 in self._opened:
            return 0.0
        return max(0.0, found.times[0] + WINDOW - now)

    def __len__(self) -> int:
        """How many addresses and keys are remembered."""
        return len(self._wrong) + len(self._opened)

    def first_refusal(self, address: str) -> bool:
        """Whether this is the one to tell of those since the last attempt that was looked at."""
        found = self._wrong.get(_place(address))
        first = found is not None and not found.told
        if found is not None:
            found.told = True
        return first

    def wrong(self, address: str, now: float) -> None:
        """It was looked at, and is none."""
        place = _place(address)
        found = self._wrong.setdefault(place, _Attempts(deque(maxlen=self._most)))
        found.times.append(now)
        found.told = False
        self._wrong.move_to_end(place)
        if len(self._wrong) > MOST:
            self._wrong.popitem(last=False)

    def opened(self, key_sha256: str) -> None:
        """It was looked at, and is somebody's."""
        self._opened[key_sha256] = None
        self._opened.move_to_end(key_sha256)
        if len(self._opened) > MOST:
            self._opened.popitem(last=False)


def _place(address: str) -> str:
    """Who has one address of an IPv6 network has 2^64 of them."""
    try:
        found = ip_address(address)
    except ValueError:  # of a socket that has none
        return address
    if isinstance(found, IPv6Address):
        return str(found.ipv4_mapped or int(found) >> _NETWORK)
    return str(found)
