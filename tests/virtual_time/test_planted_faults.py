"""The exploration finds planted faults within the budget that it has in each run (`planted`)."""

import pytest

from tests.virtual_time.clock import Clock
from tests.virtual_time.explore import Exploration, at_once, explored
from tests.virtual_time.machine import VirtualMachine
from tests.virtual_time.planted import DRIVES, SERVICE
from tests.virtual_time.sequences import Sequence
from tests.virtual_time.service import VirtualService, add_campaign
from tests.virtual_time.test_stop_anywhere import connected, stopped

SEEDS = 100
BUDGET = 30.0  # s of processor time


def found_in(outcomes: Exploration) -> None:
    assert outcomes.failed, f"not found in {len(outcomes.outcomes)} interleavings, {outcomes.cpu:.1f} CPU s"
    assert "Assertion" in outcomes.failed[0].error, outcomes.failed[0].error  # not: the fault broke itself


@pytest.mark.parametrize("fault", DRIVES)
async def test_a_fault_of_the_drivers_is_found(machine: VirtualMachine, clock: Clock, fault: str) -> None:
    port = await connected(machine)

    async def step(seed: int) -> str:
        DRIVES[fault]()
        return await stopped(port, machine, clock, seed)

    outcomes = await explored(step, range(1, SEEDS + 1), BUDGET, enough=lambda outcome: bool(outcome.error))
    await port.close()
    found_in(outcomes)


@pytest.mark.parametrize("fault", SERVICE)
def test_a_fault_of_the_service_is_found(
    service: VirtualService, machine: VirtualMachine, clock: Clock, fault: str
) -> None:
    number = add_campaign(service, poses=2)
    restore = service.snapshot()

    def step(seed: int) -> str:
        SERVICE[fault]()
        return Sequence(service, machine, clock, number, seed, pending=False).run(8)

    found_in(at_once(explored(step, range(1, SEEDS + 1), BUDGET, restore, lambda outcome: bool(outcome.error))))
