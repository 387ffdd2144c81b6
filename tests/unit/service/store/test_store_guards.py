"""Lease, latched stop and idempotency keys."""

import signal
import subprocess
import sys
import time

import pytest

from service.model.errors import Conflict, NotFound
from service.store.database import Database, open_database
from service.store.documents import StoredAnswer
from service.store.lease_and_latch import IdempotencyKeys, LeaseLost, MachineLease, MachineTaken, StopLatch
from service.store.store import Store

pytestmark = pytest.mark.slow

LEASE_TIME = 0.5  # s

HOLDER = """
import sys
from service.store.database import open_database
from service.store.lease_and_latch import MachineLease
with open_database(sys.argv[1]) as database:
    lease = MachineLease(database, 60.0)
    lease.acquire()
    print("held", flush=True)
    for _ in sys.stdin:
        lease.renew()
        print("renewed", flush=True)
"""


def test_a_second_service_is_refused_while_the_first_lives_and_gets_the_machine_when_it_is_killed(url: str) -> None:
    with open_database(url) as database:
        with subprocess.Popen(
            [sys.executable, "-c", HOLDER, url], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        ) as holder:
            assert holder.stdin is not None
            assert holder.stdout is not None
            stdin, stdout = holder.stdin, holder.stdout
            assert stdout.readline() == "held\n"

            def renewed(_: float) -> None:
                print(file=stdin, flush=True)
                assert stdout.readline() == "renewed\n"

            with pytest.raises(MachineTaken, match=f"pid {holder.pid} .*: stop that service"):
                MachineLease(database, 60.0).acquire(wait=renewed)
            holder.send_signal(signal.SIGKILL)
        began = time.monotonic()
        MachineLease(database, LEASE_TIME).acquire()
        assert time.monotonic() - began >= LEASE_TIME


def test_a_lease_that_is_released_is_free_at_once(database: Database) -> None:
    first = MachineLease(database, 60.0)
    first.acquire()
    first.release()
    MachineLease(database, 60.0).acquire(wait=_must_not_wait)


def test_a_silent_holder_learns_that_it_lost_the_machine(database: Database) -> None:
    silent, second = MachineLease(database, LEASE_TIME), MachineLease(database, LEASE_TIME)
    silent.acquire()
    second.acquire()
    with pytest.raises(LeaseLost):
        silent.renew()
    silent.release()  # must not free the other's
    second.renew()


def test_of_two_that_want_a_dead_lease_one_gets_it(database: Database) -> None:
    MachineLease(database, LEASE_TIME).acquire()
    first, second = MachineLease(database, LEASE_TIME), MachineLease(database, 60.0)
    took: list[MachineLease] = []

    def first_comes_before(_: float) -> None:
        if not took:
            took.append(first)
            first.acquire()

    with pytest.raises(MachineTaken):
        second.acquire(wait=first_comes_before)
    first.renew()


def test_a_stop_outlives_the_process_until_a_person_resets_it(url: str) -> None:
    with open_database(url) as database:
        latch = StopLatch(database)
        assert latch.latched() == ()
        first = latch.latch("operator", "smoke")
        second = latch.latch("api", "again")
    with open_database(url) as database:
        latch = StopLatch(database)
        assert latch.latched() == (first, second)
        (reset,) = latch.reset("foreman", [first.id])
        assert (reset.reset_by, latch.latched()) == ("foreman", (second,))
        assert latch.reset("another", [first.id]) == (reset,)  # sent again: nothing more
        assert latch.latched() == (second,)
        with pytest.raises(NotFound, match=f"stop {second.id + 1}"):
            latch.reset("foreman", [second.id, second.id + 1])
        assert latch.latched() == (second,)
        latch.reset("foreman", [first.id, second.id])
        assert latch.latched() == ()
        told = [(event.data["latched"], event.data["stops"]) for event in Store(database).events(0)]
        assert told == [(True, [first.id]), (True, [second.id]), (True, [first.id]), (False, [second.id])]


def test_a_key_gives_the_same_answer_twice(database: Database) -> None:
    keys = IdempotencyKeys(database)
    assert keys.claim("k", "a") is None
    with pytest.raises(Conflict, match="still being processed"):
        keys.claim("k", "a")
    keys.answer("k", 201, "{}")
    assert keys.claim("k", "a") == StoredAnswer(status=201, body="{}")
    with pytest.raises(Conflict, match="another request"):
        keys.claim("k", "b")


def test_a_key_is_free_again_when_the_work_failed_or_the_process_ended(database: Database) -> None:
    keys = IdempotencyKeys(database)
    keys.claim("failed", "a")
    keys.release("failed")
    assert keys.claim("failed", "a") is None
    keys.claim("done", "a")
    keys.answer("done", 200, "x")
    keys.release_unanswered()
    assert keys.claim("failed", "a") is None
    assert keys.claim("done", "a") is not None


def _must_not_wait(_: float) -> None:
    pytest.fail("waited for a lease that is free")
