"""The exploration finds planted faults within a hundred interleavings each."""

from functools import partial

import pytest

from tests.virtual_time.clock import Clock
from tests.virtual_time.explore import Exploration, at_once, explored
from tests.virtual_time.factory import Factory
from tests.virtual_time.machine import VirtualMachine
from tests.virtual_time.planted import DRIVES, HALT, MOVES, SERVICE, Fault
from tests.virtual_time.test_stop_anywhere import ACTIVITIES, connected, moves, stopped

SEEDS = 100


def missed(outcomes: Exploration) -> str:
    if not outcomes.failed:
        return f"not found in {len(outcomes.outcomes)} interleavings, {outcomes.cpu:.1f} CPU s"
    error = outcomes.failed[0].error
    return "" if "AssertionError" in error else f"the fault broke itself: {error}"


@pytest.mark.parametrize(
    ("machine", "fault"),
    [("canopen", fault) for fault in DRIVES | HALT] + [("modbus", fault) for fault in DRIVES],
    indirect=["machine"],
)
async def test_a_fault_of_the_drivers_is_found(machine: VirtualMachine, clock: Clock, fault: str) -> None:
    port = await connected(machine)

    async def step(seed: int) -> str:
        (DRIVES | HALT)[fault]()
        return await stopped(port, machine, clock, seed, (moves,) if fault in MOVES else ACTIVITIES[machine.fieldbus])

    outcomes = await explored(step, range(1, SEEDS + 1), enough=lambda outcome: bool(outcome.error))
    await port.close()
    print(f"{missed(outcomes) or _first(outcomes)}; {len(outcomes.outcomes)} stops, {outcomes.cpu:.1f} CPU s")
    assert not missed(outcomes), missed(outcomes)


@pytest.mark.slow
def test_faults_of_the_service_are_found(factory: Factory) -> None:
    """All from one snapshot."""
    restore = factory.service.snapshot()
    trouble: list[str] = []
    for name, fault in SERVICE.items():
        step, seeds = partial(with_fault, factory, fault), range(1, SEEDS + 1)
        outcomes = at_once(explored(step, seeds, restore, lambda outcome: bool(outcome.error)))
        why = missed(outcomes)
        print(f"{name}: {why or _first(outcomes)}; {len(outcomes.outcomes)} sequences, {outcomes.cpu:.1f} CPU s")
        trouble += [f"{name}: {why}"] * bool(why)
    restore()
    assert not trouble, "\n".join(trouble)


def with_fault(factory: Factory, fault: Fault, seed: int) -> dict[str, int]:
    fault.plant()
    return factory.sequence(seed, fault.only, fault.steps)


def _first(outcomes: Exploration) -> str:
    """By what it was found."""
    error = outcomes.failed[0].error
    return error[error.rfind("AssertionError: ") :].split("\n")[0]
