"""Deadlines kept and missed."""

import pytest

from drivers.canopen.punctuality import Punctuality


def sent(clock: Punctuality, *times: float) -> list[float]:
    return [clock.sent(time) for time in times]


def test_lateness_by_hand() -> None:
    clock = Punctuality(0.01, allowed=0, limit=1.0)
    clock.begin(5.0)
    assert sent(clock, 5.0, 5.012, 5.019) == pytest.approx([0.0, 0.002, -0.001])
    assert clock.due == pytest.approx(5.03)
    timing = clock.timing("thread")
    assert (timing.source, timing.cycles, timing.missed) == ("thread", 3, 0)
    assert (timing.median_lateness, timing.worst_lateness) == pytest.approx((0.0, 0.002))
    assert clock.verdict is None


def test_deadlines_that_passed_are_left_out() -> None:
    clock = Punctuality(0.01, allowed=3, limit=1.0)
    clock.begin(0.0)
    assert sent(clock, 0.0, 0.0455) == pytest.approx([0.0, 0.0055])
    assert clock.due == pytest.approx(0.05)
    assert clock.timing("bcm").missed == 3
    assert clock.verdict is None
    sent(clock, 0.0601)
    assert clock.verdict == ("4 deadlines of 10 ms were missed, 3 are allowed; the worst set-point was 35.5 ms late")


def test_one_lateness_can_be_too_much() -> None:
    clock = Punctuality(0.01, allowed=10**6, limit=0.5)
    clock.begin(0.0)
    sent(clock, 0.6)
    assert clock.verdict == "a set-point was 0.600 s late, 0.5 s are the limit"


def test_nothing_sent_yet() -> None:
    timing = Punctuality(0.01, allowed=0, limit=1.0).timing("thread")
    assert (timing.cycles, timing.missed, timing.median_lateness, timing.worst_lateness) == (0, 0, 0.0, 0.0)
