"""One seed, one interleaving; another seed, another one; real time and real primitives outside."""

import json
import os
import queue
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest

from tests.virtual_time.clock import Clock
from tests.virtual_time.explore import Explorer, at_once, explored
from tests.virtual_time.machine import VirtualMachine
from tests.virtual_time.scheduler import Deadlock
from tests.virtual_time.service import VirtualService, add_campaign

ROOT = Path(__file__).parents[2]


def test_real_primitives_outside_of_virtual_time() -> None:
    """This test asks for no clock, whatever ran before it in this process."""
    assert time.monotonic.__module__ == "time"
    assert type(threading.Lock()).__module__ == "_thread"
    assert queue.SimpleQueue.__module__ == "_queue"
    assert threading.Thread.start.__module__ == "threading"


def test_the_same_seed_gives_the_same_switches_and_frames(
    service: VirtualService, machine: VirtualMachine, clock: Clock
) -> None:
    number = add_campaign(service)
    restore = service.snapshot()

    def step(_seed: int) -> tuple[float, int, int]:
        service.client.start(number)
        clock.sleep(12.0)
        return clock.now, clock.scheduler.switches, len(machine.wire.cabinet.energy)

    seeds = [0, 1, 2, 3]
    one, other = (at_once(explored(step, seeds, restore=restore)) for _ in range(2))
    assert not one.failed, one.failed[0].error
    assert [(each.digest, each.told) for each in one.outcomes] == [(each.digest, each.told) for each in other.outcomes]
    assert len({each.digest for each in one.outcomes}) == len(seeds)


SCATTERED = """
import os, random, sys, pytest
chance = random.Random(os.environ["PYTHONHASHSEED"])
kept = [[bytes(size) for _ in range(3000) if chance.random() < 0.3] for size in range(0, 480, 16)]
sys.exit(pytest.main(sys.argv[1:]))
"""
"""pytest, with objects at other addresses: a set of what has no hash of its own is in the order of addresses."""


@pytest.mark.parametrize(
    ("test", "factor", "seeds"),
    [
        ("test_nothing_moves_unasked.py::test_from_a_machine_under_way", 0.08, 4),
        ("test_stop_anywhere.py::test_a_stop_at_any_moment_leaves_no_energy[modbus]", 0.34, 100),
        ("test_nothing_moves_unasked.py::test_from_a_machine_under_way", 2.0, 100),
    ],
    ids=["sequences-4", "modbus", "sequences-100"],
)
def test_another_process_repeats_each_seed(tmp_path: Path, test: str, factor: float, seeds: int) -> None:
    """Two at once, each busy beside the other and a third one, with other hashes of strings and other addresses."""
    logs = [tmp_path / name for name in ("1", "2")]
    command = [sys.executable, "-c", SCATTERED, "-q", "-p", "no:xdist", f"tests/virtual_time/{test}"]
    with subprocess.Popen([sys.executable, "-c", "while True: pass"]) as busy:
        runs = [
            subprocess.Popen(
                [*command, "--explore", str(factor), "--explore-log", str(log)],
                env=os.environ | {"PYTHONHASHSEED": log.name},
                cwd=ROOT,
                stdout=subprocess.DEVNULL,
            )
            for log in logs
        ]
        ended = [run.wait() for run in runs]
        busy.kill()
    assert ended == [0, 0]
    one, other = ([_digest(line) for line in log.read_text("utf-8").splitlines()] for log in logs)
    assert len(one) >= seeds
    assert len({digest for _, digest in one}) == len(one)
    assert one == other


def _digest(line: str) -> tuple[int, str]:
    outcome = json.loads(line)
    return outcome["seed"], outcome["digest"]


def test_who_waits_for_ever_is_told(clock: Clock) -> None:
    del clock
    empty: queue.SimpleQueue[int] = queue.SimpleQueue()
    held = threading.Lock()
    held.acquire()
    threading.Thread(target=held.acquire, name="unlucky", daemon=True).start()
    with pytest.raises(Deadlock) as stuck:
        empty.get()
    assert "test/unlucky: waits for a lock" in str(stuck.value)
    assert "test/main: waits for an item of a queue, at tests/virtual_time/test_determinism.py" in str(stuck.value)


def test_a_race_is_found_by_its_seeds(clock: Clock, explore: Explorer) -> None:
    """Two threads read, look at the clock and write: in order it is right, in some interleavings it is not."""

    def step(_seed: int) -> int:
        counted = 0

        def add() -> None:
            nonlocal counted
            before = counted
            time.monotonic()
            counted = before + 1

        both = [threading.Thread(target=add, name=name, daemon=True) for name in "ab"]
        for each in both:
            each.start()
        for each in both:
            each.join()
        return counted

    del explore
    found = at_once(explored(step, range(200)))
    assert found.outcomes[0].told == 2
    assert {outcome.told for outcome in found.outcomes} == {1, 2}
    assert clock.seed == 0
