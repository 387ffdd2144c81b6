"""A stop request at the port of the stop process, and its answer: sent, confirmed, not confirmed. Pure."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass

from service.machine.stop_process.bus import Outcome

LONGEST_WAIT = 1.0  # s that a stop waits for its confirmation; the answer comes within 1.2 s

Answer = tuple[int, dict[str, object]]  # HTTP status, JSON


@dataclass(frozen=True)
class Request:
    """Origin and reason of a stop. `press` identifies one press of a button that arrives by two ways.

    `wait`: s for the confirmation; 0: the answer is that the stop was sent.
    """

    by: str
    why: str
    press: str
    address: str
    wait: float = LONGEST_WAIT

    def words(self) -> dict[str, str]:
        """What the service is told."""
        words = asdict(self)
        del words["wait"]
        return words


def waiting_time(word: object) -> float:
    """The parameter `wait`, s from 0 to `LONGEST_WAIT`. Whatever else it is: a stop is not refused."""
    try:
        wanted = float(str(word))
    except ValueError:
        return LONGEST_WAIT
    return max(0.0, wanted) if wanted < LONGEST_WAIT else LONGEST_WAIT  # also if it is not a number


def not_confirmed(sent: bool, within: float, unconfirmed: Mapping[str, str]) -> str:
    """The sentence for a person."""
    what = f"stop sent, not confirmed within {within:g} s" if sent else "stop not sent"
    reasons = "; ".join(f"{joint}: {reason}" for joint, reason in unconfirmed.items())
    return f"{what}{': ' if reasons else ''}{reasons}; use the emergency stop"


def answer_to(wanted: Request, sent: Outcome, confirmed: Outcome | None) -> Answer:
    """`confirmed`: None if it is not waited for. 200 only if every axis reports standstill without energy."""
    if confirmed is None and sent.good:
        doubts = {joint: doubt for joint, doubt in sent.joints.items() if doubt}
        return 202, {"sent": sent.good, "confirmed": (), "unconfirmed": doubts}
    reported = sent if confirmed is None else confirmed
    stands = () if confirmed is None else confirmed.good
    unconfirmed = {joint: doubt for joint, doubt in reported.joints.items() if doubt}
    # a bus that was opened meanwhile got the stop at once
    told = sent.good or (() if confirmed is None or confirmed.trouble else tuple(confirmed.joints))
    facts: dict[str, object] = {"sent": told, "confirmed": stands, "unconfirmed": unconfirmed}
    if stands and not unconfirmed:
        return 200, facts
    trouble = unconfirmed or {"stop process": reported.trouble or "no drive is known"}
    return 503, {
        "type": "urn:sweepid:problem:stop-not-confirmed",
        "title": "Service Unavailable",
        "status": 503,
        "detail": not_confirmed(bool(told), wanted.wait, trouble),
        **facts,
    }
