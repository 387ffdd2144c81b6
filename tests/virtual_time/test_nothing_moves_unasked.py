"""Random sequences of commands, stops, faults, gaps and kills: nothing has energy that no person asked for."""

from collections import Counter
from collections.abc import Callable

from tests.virtual_time.explore import Explorer
from tests.virtual_time.factory import Factory

SEEDS = 70
BUDGET = 30.0  # s of processor time


def test_from_a_machine_that_stands(factory: Factory, explore: Explorer) -> None:
    told(explore, factory.sequence, factory.service.snapshot())


def test_from_a_machine_under_way(factory: Factory, explore: Explorer) -> None:
    factory.begin()
    told(explore, factory.sequence, factory.service.snapshot())


def told(explore: Explorer, step: Callable[[int], dict[str, int]], restore: Callable[[], None]) -> None:
    found = explore.run_now(step, SEEDS, BUDGET, restore)
    restore()
    counted: Counter[str] = Counter()
    for outcome in found.outcomes:
        if isinstance(outcome.told, dict):
            counted.update(outcome.told)
    virtual = sum(outcome.virtual for outcome in found.outcomes)
    print(f"{len(found.outcomes)} sequences, {found.cpu:.1f} CPU s, {virtual:.0f} virtual s, {dict(counted)}")
