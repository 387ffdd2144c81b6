"""Every fault to order at every adapter, through the service: what happens, what a person is told, how it goes on.

One campaign of one sweep a fault; the fault comes in the middle of the sweep or before connecting. Whatever the fault,
no axis keeps its energy, none gets it back before a person acts, samples so far are kept and marked, the cause is in
the API and in the log, and after the person has acted the sweep is measured. What was seen is the row of
`docs/reference/faults.md`; a difference fails. After a wanted change: ``pytest tests/system/test_fault_table.py
--write-fault-table``.
"""

import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from pathlib import Path

import httpx
import pytest

from service.client import Json, ServiceClient, ServiceProblem
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
AXIS, OTHER = "joint_1", "joint_3"
OWN_SWEEP = 1.5  # times real time: a sweep takes 3.7 s, an order falls into it on a busy computer too
STREAMED_SWEEP = 20.0  # of the moves: a streamed sweep is in real time whatever this is


@dataclass(frozen=True)
class Adapter:
    """A column of the table."""

    name: str
    fieldbus: Fieldbus
    modes: str
    speed_factor: float = OWN_SWEEP


ADAPTERS = (
    Adapter("CANopen, drive's own sweep", Fieldbus.CANOPEN, "drive_side"),
    Adapter("CANopen, streamed sweep", Fieldbus.CANOPEN, "host_streamed", STREAMED_SWEEP),
    Adapter("Modbus TCP", Fieldbus.MODBUS_TCP, "drive_side"),
)
OR = "<br>or "  # between the outcomes of a race, in a cell that a person has completed
STREAMED = {ADAPTERS[1].name}
ON_CAN = {ADAPTERS[0].name, ADAPTERS[1].name}
EVERYWHERE = {adapter.name for adapter in ADAPTERS}

Order = tuple[str, dict[str, object]]


@dataclass(frozen=True)
class Fault:
    """A row of the table: orders that make it and take it back, and the adapters that can meet it."""

    name: str
    make: Order
    undo: tuple[Order, ...] = ()
    adapters: set[str] = field(default_factory=lambda: EVERYWHERE)
    before_connecting: bool = False


def _axis(name: str, **fields: object) -> Order:
    return name, {"joint": AXIS, **fields}


FAULTS = (
    Fault("drive fault", _axis("fault", code=0x7305)),
    Fault("fault of an axis that stands", ("fault", {"joint": OTHER, "code": 0x4310})),
    Fault("EMCY without a fault state", _axis("emcy", code=0x4210), adapters=ON_CAN),
    Fault("lost PDO", _axis("drop_tpdos", count=1), adapters=STREAMED),
    Fault("duplicated PDOs", _axis("duplicate_tpdos", count=20), adapters=STREAMED),
    Fault("late PDOs", _axis("delay_tpdos", count=3, cycles=2), adapters=STREAMED),
    Fault("bus-off", ("bus_off", {}), undo=(("bus_on", {}),), adapters=ON_CAN),
    Fault("silent node", _axis("silence", on=True), undo=(_axis("silence", on=False),)),
    Fault(
        "silent node that stands",
        ("silence", {"joint": OTHER, "on": True}),
        undo=(("silence", {"joint": OTHER, "on": False}),),
    ),
    Fault(
        "frozen sample counter",
        _axis("freeze_counter", on=True),
        undo=(_axis("freeze_counter", on=False),),
        adapters=STREAMED,
    ),
    Fault("limit switch", _axis("limit", on=True), undo=(_axis("limit", on=False),)),
    Fault("emergency stop", ("emergency_stop", {"on": True}), undo=(("emergency_stop", {"on": False}),)),
    Fault("small encoder glitch", _axis("glitch", revolutions=0.02)),
    Fault("large encoder glitch", _axis("glitch", revolutions=50.0)),
    Fault("torque saturation", _axis("saturate", torque_permille=5), undo=(_axis("saturate", torque_permille=None),)),
    Fault("reboot of the node", _axis("reboot")),
    Fault(
        "wrong identity",
        _axis("identity", product=0x0999),
        undo=(_axis("identity", product=0x0402),),
        before_connecting=True,
    ),
    Fault(
        "swapped addresses",
        _axis("swap", **{"with": "joint_2"}),
        undo=(_axis("swap", **{"with": "joint_2"}),),
        before_connecting=True,
    ),
)


@dataclass
class Bench:
    """One virtual machine, one service on it, and what a person and an operator's page see."""

    adapter: Adapter
    machine: VirtualMachine
    service: Service
    client: ServiceClient
    plan: int

    def order(self, order: Order) -> None:
        name, fields = order
        reply = self.machine.order(name, **fields)
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

    def recording(self, campaign: int) -> str:
        recording = f"{self.service.url}/api/v1/campaigns/{campaign}/sweeps/1/recording"
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


@contextmanager
def bench_of(adapter: Adapter, folder: Path) -> Iterator[Bench]:
    with ExitStack() as stack:
        machine = stack.enter_context(virtual_machine(folder, adapter.speed_factor, adapter.fieldbus))
        service = stack.enter_context(serving(folder, machine.profile))
        client = stack.enter_context(ServiceClient(service.url))
        plan = add_plan(client, axes=[AXIS], varied=["joint_2"], step=60.0, poses=1, modes=adapter.modes)
        yield Bench(adapter, machine, service, client, plan)


@pytest.fixture(scope="module")
def bench(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Bench]:
    with bench_of(request.param, tmp_path_factory.mktemp("faults")) as bench:
        yield bench


Table = dict[str, dict[str, str]]


@pytest.fixture(scope="module")
def table(request: pytest.FixtureRequest) -> Iterator[Callable[[Fault, Adapter, str], None]]:
    """Compares a cell with the document's, or writes the document anew."""
    writing = bool(request.config.getoption("--write-fault-table", default=False))
    written = read_table()

    def cell(fault: Fault, adapter: Adapter, seen: str) -> None:
        documented = written.get(fault.name, {}).get(adapter.name, "").split(OR)
        if not writing:
            assert seen in documented
        elif seen not in documented:
            written.setdefault(fault.name, {})[adapter.name] = seen

    yield cell
    if writing:
        write_table(written)


def read_table() -> Table:
    _, rows, _ = DOCUMENT.read_text("utf-8").split("<!-- table -->\n")
    cells = [[cell.strip() for cell in line.strip("|").split("|")] for line in rows.splitlines() if line]
    return {row[0]: dict(zip(cells[0][1:], row[1:], strict=True)) for row in cells[2:]}


def write_table(table: Table) -> None:
    before, _, after = DOCUMENT.read_text("utf-8").split("<!-- table -->\n")
    names = [adapter.name for adapter in ADAPTERS]
    lines = [["fault", *names], ["---"] * (1 + len(names))]
    lines += [[fault.name, *(table.get(fault.name, {}).get(name, "–") for name in names)] for fault in FAULTS]
    rows = "\n".join(f"| {' | '.join(line)} |" for line in lines)
    DOCUMENT.write_text(f"{before}<!-- table -->\n\n{rows}\n\n<!-- table -->\n{after}", "utf-8")


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    if {"bench", "fault"} <= set(metafunc.fixturenames):
        cells = [
            pytest.param(adapter, fault, id=f"{adapter.name}-{fault.name}")
            for adapter in ADAPTERS
            for fault in FAULTS
            if adapter.name in fault.adapters
        ]
        metafunc.parametrize(("bench", "fault"), cells, indirect=["bench"], scope="module")


def test_a_fault_ends_in_standstill_and_waits_for_a_person(
    bench: Bench, fault: Fault, table: Callable[[Fault, Adapter, str], None]
) -> None:
    try:
        seen = before_connecting(bench, fault) if fault.before_connecting else in_a_sweep(bench, fault)
    except BaseException:
        for order in fault.undo:  # the next fault comes alone
            bench.order(order)
        raise
    table(fault, bench.adapter, seen)


def in_a_sweep(bench: Bench, fault: Fault) -> str:
    campaign = bench.into_a_sweep()
    bench.order(fault.make)
    document = bench.held(campaign)
    bench.keeps_standing()
    (sweep,) = bench.client.sweeps(campaign)
    if document["state"] == "completed":
        assert sweep["state"] == "identified"
        return "sweep goes on, complete recording"
    assert document["state"] == "paused"
    cause = sweep["cause"]
    assert cause
    assert cause.startswith(document["cause"])  # the sweep also tells whether the stop was confirmed
    assert cause in bench.service.log()
    kept = bench.recording(campaign)
    for order in fault.undo:
        bench.order(order)
    bench.keeps_standing()
    if bench.client.drives()["connected"] and bench.faulty():
        refused_without_acknowledgement(bench, campaign)
    acts = bench.person_acts()
    bench.client.resume(campaign, repeat=True)
    again = bench.held(campaign)
    assert (again["state"], again["cause"]) == ("completed", "")
    return f"stopped: {cause.split(':')[0]}; {kept} recording; {', '.join([*acts, 'resume'])}"


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
    return f"never started: not connected; {', '.join([*acts, 'start'])}"


def test_the_table_has_a_row_for_every_fault_and_a_cell_for_every_adapter() -> None:
    table = read_table()
    assert list(table) == [fault.name for fault in FAULTS]
    for fault in FAULTS:
        for adapter in ADAPTERS:
            assert (table[fault.name][adapter.name] != "–") == (adapter.name in fault.adapters)
