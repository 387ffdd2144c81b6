"""Random sequences of commands, stops, faults, gaps and kills: nothing has energy that no person asked for."""

from tests.virtual_time.clock import Clock
from tests.virtual_time.explore import Explorer
from tests.virtual_time.machine import VirtualMachine
from tests.virtual_time.sequences import Sequence
from tests.virtual_time.service import VirtualService, add_campaign


def test_random_sequences(service: VirtualService, machine: VirtualMachine, clock: Clock, explore: Explorer) -> None:
    number = add_campaign(service, poses=2)
    restore = service.snapshot()

    def step(seed: int) -> str:
        return Sequence(service, machine, clock, number, seed, pending=False).run(8)

    found = explore.run_now(step, 20, budget=60.0, restore=restore)
    print(f"{len(found.outcomes)} sequences in {found.cpu:.1f} CPU s, {sum(o.virtual for o in found.outcomes):.0f} s")
