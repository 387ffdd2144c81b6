"""Random sequences of commands, stops, faults, gaps and kills: nothing has energy that no person asked for."""

from collections import Counter
from collections.abc import Callable
from functools import partial

import pytest

from tests.virtual_time import sequences as s
from tests.virtual_time.explore import Explorer, at_once
from tests.virtual_time.factory import Factory
from tests.virtual_time.sequences import Action

SEEDS = 50
ONCE, FEW = (1, 1), (3, 5)  # steps
PROMISES: dict[str, tuple[tuple[Action, ...], tuple[int, int]]] = {
    "a stop ends what was wanted before it": ((s.change_of_mind,), ONCE),
    "a stop outlives the service": ((s.stop_outlives_a_kill,), ONCE),
    "a release is for what was seen": ((s.late_release,), ONCE),
    "a stop reaches the drives of a suspended service": ((s.stop_in_a_gap,), ONCE),
    "an abort takes the energy away": ((s.broken_off,), ONCE),
    "a missing sign of life is standstill": ((s.attended,), ONCE),
    "a pause that is taken back keeps the sign of life": ((s.start, s.pause_taken_back), FEW),
    "nothing moves after a gap until a person resumes": ((s.start, s.connect, s.host_gap), FEW),
    "the death of the service is a stop": ((s.start, s.kill), FEW),
    "one service at a time moves the machine": ((s.start, s.second_service), (2, 3)),
    "a stop ends approvals, and without one nothing moves": ((s.start, s.stop_by_port, s.release, s.approve), FEW),
    "nothing goes on after a fault": ((s.start, s.drive_fault, s.acknowledge), FEW),
    "a stop does not wait for the database": ((s.start, s.blocked_database, s.stop_by_api, s.stop_by_port), FEW),
}
EACH = 100


def test_from_a_machine_that_stands(factory: Factory, explore: Explorer) -> None:
    told(explore, factory.sequence, factory.service.snapshot())


def test_from_a_machine_under_way(factory: Factory, explore: Explorer) -> None:
    factory.begin()
    told(explore, factory.sequence, factory.service.snapshot())


@pytest.mark.parametrize("promise", PROMISES)
def test_a_promise(factory: Factory, explore: Explorer, promise: str) -> None:
    """Only what concerns it happens: each is judged in a hundred interleavings."""
    only, steps = PROMISES[promise]
    told(explore, partial(factory.sequence, only=only, steps=steps), factory.service.snapshot(), EACH)


def told(
    explore: Explorer, step: Callable[[int], dict[str, int]], restore: Callable[[], None], seeds: int = SEEDS
) -> None:
    found = at_once(explore.run(step, seeds, restore=restore))
    restore()
    counted: Counter[str] = Counter()
    for outcome in found.outcomes:
        if isinstance(outcome.told, dict):
            counted.update(outcome.told)
    virtual = sum(outcome.virtual for outcome in found.outcomes)
    print(f"{len(found.outcomes)} sequences, {found.cpu:.1f} CPU s, {virtual:.0f} virtual s, {dict(counted)}")
