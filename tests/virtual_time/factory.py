"""Where random sequences begin: a machine without elasticity, and a service that wants plans approved."""

from collections.abc import Callable, Sequence
from concurrent.futures import Future
from dataclasses import dataclass
from pathlib import Path

import httpx

from tests.virtual_time.clock import Clock
from tests.virtual_time.machine import CONFIG, VirtualMachine
from tests.virtual_time.sequences import STEPS, Action, Session
from tests.virtual_time.service import VirtualService, add_campaign

RIGID = CONFIG / "scenarios" / "max100-rigid.yaml"
NEVER = 1e6  # s: what is identified is no matter here
COARSE = 40  # cycles of the plant in one call


@dataclass
class Factory:
    """Two campaigns, the second of simultaneous sweeps; the plan of the first is approved. No drive has a fault."""

    service: VirtualService
    machine: VirtualMachine
    clock: Clock
    campaigns: tuple[int, int]
    begun: "Future[httpx.Response] | None" = None

    def begin(self) -> None:
        """The first campaign runs, and an axis has energy."""
        self.begun = self.service.send("POST", f"/campaigns/{self.campaigns[0]}/start", {})
        self.clock.wait_until(self.machine.energised, "energised")

    def sequence(self, seed: int, only: Sequence[Action] = (), steps: tuple[int, int] = STEPS) -> dict[str, int]:
        """One random sequence from here."""
        session = Session(self.service, self.machine, self.clock, self.campaigns, seed, only, steps)
        if self.begun is not None:
            session.oracle.command(self.campaigns[0], self.begun)
        return session.run()


def open_factory(folder: Path, clock: Clock) -> tuple[Factory, Callable[[], None]]:
    """And what closes it."""
    machine = VirtualMachine(folder, scenario=RIGID)
    machine.wire.cabinet.careful = COARSE
    service = VirtualService(folder, machine, clock, approval=True)
    service.job = NEVER
    service.start()
    client = service.client
    campaigns = add_campaign(service, poses=2), add_campaign(service, poses=2, simultaneous=True)
    client.approve(service.plans[0], client.approvals(service.plans[0])["sha256"], "Ada")
    for axis in client.drives()["axes"]:
        client.acknowledge(axis["joint"])
    return Factory(service, machine, clock, campaigns), service.close
