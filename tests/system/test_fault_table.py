"""Every fault to order at every adapter, through the service: what happens, what a person is told, how it goes on.

One campaign of one sweep a fault, of two axes where they move at once; the fault comes in the middle of the sweep or
before connecting. Whatever the fault,
no axis keeps its energy, none gets it back before a person acts, samples so far are kept and marked, the cause is in
the API and in the log, and after the person has acted the sweep is measured. What was seen is the cell of
`docs/reference/faults.md`; a difference fails.
"""

import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import httpx
import pytest

from service.web.client import Json, ServiceClient, ServiceProblem
from tests.faults import ADAPTERS, AXIS, FAULTS, MODBUS, OWN_SWEEP, STREAMED, TOGETHER, Adapter, Fault, Order
from tests.system.rest_bench import (
    Fieldbus,
    Service,
    VirtualMachine,
    add_plan,
    release,
    serving,
    until,
    virtual_machine,
)

DOCUMENT = Path(__file__).parents[2] / "docs" / "reference" / "faults.md"
SPEED = {OWN_SWEEP.name: 1.5, STREAMED.name: 20.0, TOGETHER.name: 20.0, MODBUS.name: 1.5}
"""Times real time: an own sweep takes 3.7 s, an order falls into it on a busy computer too; a streamed one is in it."""
OR = "<br>or "  # between the outcomes of a race, in a cell that a person has completed


@dataclass
class Bench:
    """One virtual machine, one service on it, and what a person and an operator's page see."""

    adapter: Adapter
    machine: VirtualMachine
    service: Service
    client: ServiceClient
    plan: int

    def order(self, order: Order) -> None:
        reply = self.machine.order(order[0], **order[1])
        assert reply["ok"], reply

    def into_a_sweep(self) -> int:
        """A new campaign with its sweep under way; its number. A stop that a failed test left behind is released."""
        if self.client.stops():
            release(self.client)
        self.person_acts()
        campaign = int(self.client.add_campaign(self.plan)["id"])
        self.client.start(campaign)
        first: list[int] = []

        def well_inside() -> bool:
            document = self.client.campaign(campaign)
            assert document["state"] == "running", document["cause"]
            status = self.machine.order("status")
            axis = status["axes"][AXIS]
            if self.adapter.modes == "drive_side":
                return bool(axis["measuring"] == "running" and axis["samples"] > 200)
            if axis["mode"] == 9:
                first.append(status["sync_counter"])
            return bool(first) and status["sync_counter"] > first[0] + 100

        until(well_inside, "no sweep under way")
        return campaign

    def held(self, campaign: int) -> Json:
        """The campaign once it does not run any more."""
        until(lambda: self.client.campaign(campaign)["state"] not in ("running", "measured"), "still running")
        return self.client.campaign(campaign)

    def keeps_standing(self) -> None:
        """No energy, and none comes back by itself."""
        until(self.machine.stands, "the axes do not stand")
        end = time.monotonic() + 0.5
        while time.monotonic() < end:
            assert self.machine.stands()
            time.sleep(0.02)

    def recording(self, campaign: int, sweep: int) -> str:
        recording = f"{self.service.url}/api/v1/campaigns/{campaign}/sweeps/{sweep}/recording"
        answer = httpx.get(recording, timeout=60, trust_env=False)
        return "no samples" if answer.status_code == 404 else str(answer.raise_for_status().json()["state"])

    def connect(self) -> httpx.Response:
        return httpx.post(f"{self.service.url}/api/v1/drives/connect", timeout=60, trust_env=False)

    def faulty(self) -> list[str]:
        return [axis["joint"] for axis in self.client.drives()["axes"] if axis["fault"]]

    def person_acts(self) -> list[str]:
        """What a person must do so that the machine may move again; does it."""
        acts: list[str] = []
        if not self.client.drives()["connected"]:
            answer = self.connect()
            assert answer.is_success, answer.text
            acts.append("connect")
        faulty = self.faulty()
        for joint in faulty:
            self.client.acknowledge(joint)
        return [*acts, "acknowledge"] if faulty else acts


@pytest.fixture(scope="module")
def bench(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Bench]:
    adapter, folder = request.param, tmp_path_factory.mktemp("faults")
    with (
        virtual_machine(folder, SPEED[adapter.name], Fieldbus(adapter.fieldbus)) as machine,
        serving(folder, machine.profile) as service,
        ServiceClient(service.url) as client,
    ):
        together = len(adapter.axes) > 1
        wanted: Json = {"axes": adapter.axes, "varied": ["joint_2"], "step": 60.0, "poses": 1, "modes": adapter.modes}
        plan = add_plan(client, **wanted, simultaneous=together)
        yield Bench(adapter, machine, service, client, plan)


Table = dict[str, dict[str, str]]


def read_table() -> Table:
    _, rows, _ = DOCUMENT.read_text("utf-8").split("<!-- table -->\n")
    cells = [[cell.strip() for cell in line.strip("|").split("|")] for line in rows.splitlines() if line]
    return {row[0]: dict(zip(cells[0][1:], row[1:], strict=True)) for row in cells[2:]}


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    if {"bench", "name"} <= set(metafunc.fixturenames):
        cells = [
            pytest.param(adapter, name, id=f"{adapter.name}-{name}")
            for adapter in ADAPTERS
            for name, fault in FAULTS.items()
            if adapter in fault.adapters
        ]
        metafunc.parametrize(("bench", "name"), cells, indirect=["bench"], scope="module")


def test_a_fault_ends_in_standstill_and_waits_for_a_person(bench: Bench, name: str) -> None:
    fault = FAULTS[name]
    try:
        seen = before_connecting(bench, fault) if fault.before_connecting else in_a_sweep(bench, fault)
    except BaseException:
        for order in fault.undo:  # the next fault comes alone
            bench.order(order)
        raise
    assert seen in read_table()[name][bench.adapter.name].split(OR)


def in_a_sweep(bench: Bench, fault: Fault) -> str:
    campaign = bench.into_a_sweep()
    bench.order(fault.make)
    document = bench.held(campaign)
    bench.keeps_standing()
    sweeps = bench.client.sweeps(campaign)
    assert {sweep["spec"]["axis"] for sweep in sweeps} == set(bench.adapter.axes)
    if document["state"] == "completed":
        assert {sweep["state"] for sweep in sweeps} == {"identified"}
        return "goes on; complete"
    assert document["state"] == "paused"
    (cause,) = {sweep["cause"] for sweep in sweeps if sweep["cause"]}
    assert cause.startswith(document["cause"])  # the sweep also tells whether the stop was confirmed
    assert cause in bench.service.log()
    (code,) = {sweep["structured_cause"]["code"] for sweep in sweeps if sweep["cause"]}
    assert code == document["structured_cause"]["code"]
    (kept,) = {bench.recording(campaign, number) for number, _ in enumerate(sweeps, 1)}
    for order in fault.undo:
        bench.order(order)
    bench.keeps_standing()
    if bench.client.drives()["connected"] and bench.faulty():
        refused_without_acknowledgement(bench, campaign)
    acts = bench.person_acts()
    bench.client.resume(campaign, repeat=True)
    again = bench.held(campaign)
    assert (again["state"], again["cause"]) == ("completed", "")
    return f"{code}; {kept}; {', '.join([*acts, 'resume'])}"


def refused_without_acknowledgement(bench: Bench, campaign: int) -> None:
    before = {joint: axis["position"] for joint, axis in bench.machine.axes().items()}
    try:
        bench.client.resume(campaign, repeat=True)
    except ServiceProblem:
        pass
    else:
        assert bench.held(campaign)["state"] == "paused"
    bench.keeps_standing()
    after = {joint: axis["position"] for joint, axis in bench.machine.axes().items()}
    assert after == pytest.approx(before, abs=1e-5)


def before_connecting(bench: Bench, fault: Fault) -> str:
    bench.order(fault.make)
    answer = bench.connect()
    assert not answer.is_success
    cause = bench.client.drives()["trouble"]
    assert cause
    assert cause in answer.json()["detail"]
    assert bench.client.drives()["trouble_cause"]["code"] == "wrong_identity"
    campaign = int(bench.client.add_campaign(bench.plan)["id"])
    with pytest.raises(ServiceProblem) as refused:
        bench.client.start(campaign)
    assert cause in refused.value.detail
    bench.keeps_standing()
    for order in fault.undo:
        bench.order(order)
    acts = bench.person_acts()
    bench.client.start(campaign)
    document = bench.held(campaign)
    assert (document["state"], document["cause"]) == ("completed", "")
    return f"not connected; {', '.join([*acts, 'start'])}"


def test_the_table_has_a_row_for_every_fault_and_a_cell_for_every_adapter() -> None:
    met = {row: {name for name, cell in cells.items() if cell != "–"} for row, cells in read_table().items()}
    assert met == {name: {adapter.name for adapter in fault.adapters} for name, fault in FAULTS.items()}
    assert list(met) == list(FAULTS)
