"""Random sequences of commands, stops, faults, gaps and kills: nothing has energy that no person asked for."""

from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from tests.virtual_time.clock import Clock
from tests.virtual_time.explore import Explorer
from tests.virtual_time.machine import CONFIG, VirtualMachine
from tests.virtual_time.sequences import Session
from tests.virtual_time.service import VirtualService, add_campaign

RIGID = CONFIG / "scenarios" / "max100-rigid.yaml"
NEVER = 1e6  # s: what is identified is no matter here
COARSE = 40  # cycles of the plant in one call


@pytest.fixture
def factory(clock: Clock, tmp_path: Path) -> Iterator[tuple[VirtualService, VirtualMachine, list[int]]]:
    """A machine without elasticity, a service that wants plans approved, and two campaigns; one plan is approved."""
    machine = VirtualMachine(tmp_path, RIGID)
    machine.wire.cabinet.careful = COARSE
    service = VirtualService(tmp_path, machine, clock, approval=True)
    service.job = NEVER
    service.start()
    campaigns = [add_campaign(service, poses=2, modes=modes) for modes in ("drive_side", "host_streamed")]
    approve_plan(service, service.plans[0])
    for joint in service.client.drives()["axes"]:
        service.client.acknowledge(joint["joint"])
    yield service, machine, campaigns
    service.close()


def approve_plan(service: VirtualService, plan: int) -> None:
    service.client.approve(plan, service.client.approvals(plan)["sha256"], "Ada")


def test_from_a_machine_that_stands(
    factory: tuple[VirtualService, VirtualMachine, list[int]], clock: Clock, explore: Explorer
) -> None:
    service, machine, campaigns = factory
    told(explore, lambda seed: Session(service, machine, clock, campaigns, seed).run(), service.snapshot())


def test_from_a_machine_that_moves(
    factory: tuple[VirtualService, VirtualMachine, list[int]], clock: Clock, explore: Explorer
) -> None:
    service, machine, campaigns = factory
    begin = service.send("POST", f"/campaigns/{campaigns[0]}/start", {})
    clock.wait_until(machine.energised, "energised")
    restore = service.snapshot()

    def step(seed: int) -> dict[str, int]:
        session = Session(service, machine, clock, campaigns, seed)
        session.oracle.command(campaigns[0], begin)
        return session.run()

    told(explore, step, restore)


def told(explore: Explorer, step: Callable[[int], dict[str, int]], restore: Callable[[], None]) -> None:
    found = explore.run_now(step, 40, budget=15.0, restore=restore)
    restore()
    counted: Counter[str] = Counter()
    for outcome in found.outcomes:
        if isinstance(outcome.told, dict):
            counted.update(outcome.told)
    virtual = sum(outcome.virtual for outcome in found.outcomes)
    print(f"{len(found.outcomes)} sequences, {found.cpu:.1f} CPU s, {virtual:.0f} virtual s, {dict(counted)}")
