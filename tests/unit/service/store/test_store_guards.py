"""Lease, latched stop and idempotency keys; and several cells on one database.

What belongs to a machine is read by all and changed by its own service alone.
"""

import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from datetime import timedelta
from pathlib import Path

import pytest

from drivers.ports import SweepMode
from service import Conflict, NotFound
from service.model import Robot, SweepSpec
from service.planning.campaigns.state_machine import CampaignEvent, SweepEvent, campaign_move, sweep_move
from service.store.database import Database, open_database
from service.store.diagnoses import DiagnosisStore
from service.store.documents import CampaignDocument, CampaignState, NewDiagnosis, NewSweep, StoredAnswer, SweepState
from service.store.files.data_folder import ForeignFolder, claim_folder
from service.store.lease_and_latch import (
    ApprovalStore,
    IdempotencyKeys,
    LeaseLost,
    MachineLease,
    MachineTaken,
    StopLatch,
)
from service.store.store import Store
from service.store.table_rows import NoMachine, OtherMachine
from tests.unit.service.store.conftest import Specs, must_not_wait

pytestmark = pytest.mark.slow


LEASE_TIME = 0.5  # s


HOLDER = """
import sys
from service.store.database import open_database
from service.store.lease_and_latch import MachineLease
with open_database(sys.argv[1]) as database:
    lease = MachineLease(database, 60.0)
    lease.acquire()
    print("held", flush=True)
    for _ in sys.stdin:
        lease.renew()
        print("renewed", flush=True)
"""


def test_a_second_service_is_refused_while_the_first_lives_and_gets_the_machine_when_it_is_killed(url: str) -> None:
    with open_database(url) as database:
        with subprocess.Popen(
            [sys.executable, "-c", HOLDER, url], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        ) as holder:
            assert holder.stdin is not None
            assert holder.stdout is not None
            stdin, stdout = holder.stdin, holder.stdout
            assert stdout.readline() == "held\n"

            def renewed(_: float) -> None:
                print(file=stdin, flush=True)
                assert stdout.readline() == "renewed\n"

            with pytest.raises(MachineTaken, match=f"pid {holder.pid} .*: stop that service"):
                MachineLease(database, 60.0).acquire(wait=renewed)
            holder.send_signal(signal.SIGKILL)
        began = time.monotonic()
        MachineLease(database, LEASE_TIME).acquire()
        assert time.monotonic() - began >= LEASE_TIME


def test_a_silent_holder_learns_that_it_lost_the_machine(database: Database) -> None:
    silent, second = MachineLease(database, LEASE_TIME), MachineLease(database, LEASE_TIME)
    silent.acquire()
    second.acquire()
    with pytest.raises(LeaseLost):
        silent.renew()
    silent.release()  # must not free the other's
    second.renew()


def test_of_two_that_want_a_dead_lease_one_gets_it(database: Database) -> None:
    MachineLease(database, LEASE_TIME).acquire()
    first, second = MachineLease(database, LEASE_TIME), MachineLease(database, 60.0)
    took: list[MachineLease] = []

    def first_comes_before(_: float) -> None:
        if not took:
            took.append(first)
            first.acquire()

    with pytest.raises(MachineTaken):
        second.acquire(wait=first_comes_before)
    first.renew()


def test_a_stop_outlives_the_process_until_a_person_resets_it(url: str) -> None:
    with open_database(url) as database:
        latch = StopLatch(database)
        assert latch.latched() == ()
        first = latch.latch("operator", "smoke")
        second = latch.latch("api", "again")
    with open_database(url) as database:
        latch = StopLatch(database)
        assert latch.latched() == (first, second)
        (reset,) = latch.reset("foreman", [first.id])
        assert (reset.reset_by, latch.latched()) == ("foreman", (second,))
        assert latch.reset("another", [first.id]) == (reset,)  # sent again: nothing more
        assert latch.latched() == (second,)
        with pytest.raises(NotFound, match=f"stop {second.id + 1}"):
            latch.reset("foreman", [second.id, second.id + 1])
        assert latch.latched() == (second,)
        latch.reset("foreman", [first.id, second.id])
        assert latch.latched() == ()
        told = [(event.data["latched"], event.data["stops"]) for event in Store(database).events(0)]
        assert told == [(True, [first.id]), (True, [second.id]), (True, [first.id]), (False, [second.id])]


def test_a_key_gives_the_same_answer_twice_and_is_free_again_when_the_work_failed(database: Database) -> None:
    keys = IdempotencyKeys(database)
    for again in (lambda: keys.release("k"), keys.release_unanswered):  # it failed, or its process ended
        assert keys.claim("k", "a") is None
        with pytest.raises(Conflict, match="still being processed"):
            keys.claim("k", "a")
        again()
    assert keys.claim("k", "a") is None
    keys.answer("k", 201, "{}")
    keys.release_unanswered()
    assert keys.claim("k", "a") == StoredAnswer(status=201, body="{}")
    with pytest.raises(Conflict, match="another request"):
        keys.claim("k", "b")


RUNNING, PLANNED = campaign_move(CampaignEvent.START), sweep_move(SweepEvent.BEGIN)


@pytest.fixture
def cells(url: str) -> Iterator[tuple[Database, Database]]:
    """The database as the services of two machines open it."""
    with open_database(url, machine="cell A") as a, open_database(url, machine="cell B") as b:
        yield a, b


def started(database: Database, robot: Robot, spec: SweepSpec) -> CampaignDocument:
    store = Store(database)
    plan = store.add_plan(store.add_robot(robot).id, {"any": "document"})
    campaign = store.add_campaign(plan.id, [NewSweep(spec=spec, mode=SweepMode.HOST_STREAMED)])
    store.move_campaign(campaign.id, RUNNING)
    store.begin_sweep(campaign.id, 1, PLANNED)
    return store.campaign(campaign.id)


def test_two_machines_are_held_by_two_services_at_once(cells: tuple[Database, Database]) -> None:
    first, second = leases = [MachineLease(cell, 60.0) for cell in cells]
    for lease in leases:
        lease.acquire(wait=must_not_wait)
    for lease in leases:
        lease.renew()
    third = MachineLease(cells[0], LEASE_TIME)
    with pytest.raises(MachineTaken, match=r"in use by another service .* than 'cell A', set `machine_name`"):
        third.acquire(wait=lambda _: first.renew())
    first.release()
    third.acquire(wait=must_not_wait)
    second.renew()  # the other cell's is not touched


def test_a_campaign_is_read_by_all_and_changed_by_its_own(
    cells: tuple[Database, Database], robot: Robot, specs: Specs
) -> None:
    a, b = map(Store, cells)
    campaign = started(cells[0], robot, specs[0])
    assert (campaign.machine, campaign.here) == ("cell A", True)
    seen = b.campaign(campaign.id)
    assert (seen.machine, seen.here, seen.state) == ("cell A", False, CampaignState.RUNNING)
    refused = rf"campaign {campaign.id} belongs to machine 'cell A': send it to the service of that machine"
    interrupt = sweep_move(SweepEvent.INTERRUPT)
    assert a.own_campaign(campaign.id) == campaign
    changes = (
        lambda: b.own_campaign(campaign.id),
        lambda: b.move_campaign(campaign.id, campaign_move(CampaignEvent.PAUSE)),
        lambda: b.move_campaign(campaign.id, campaign_move(CampaignEvent.ABORT)),
        lambda: b.begin_sweep(campaign.id, 1, PLANNED),
        lambda: b.move_sweep(campaign.id, 1, interrupt),
        lambda: b.end_sweep(campaign.id, 1, interrupt),
        lambda: b.add_check_move(campaign.id, 1, "joint_1", 0.01, "rad"),
    )
    before = a.last_event_id()
    for change in changes:
        with pytest.raises(OtherMachine, match=refused):
            change()
    assert a.sweep(campaign.id, 1).state is SweepState.RUNNING
    assert a.last_event_id() == before


def test_what_a_start_recovers_is_its_own(cells: tuple[Database, Database], robot: Robot, specs: Specs) -> None:
    own, other = started(cells[0], robot, specs[0]), started(cells[1], robot, specs[1])
    for cell, campaign in zip(cells, (own, other), strict=True):
        store = Store(cell)
        assert [one.id for one in store.campaigns_in(CampaignState.RUNNING)] == [campaign.id]
        assert [one.campaign_id for one in store.sweeps_in(SweepState.RUNNING)] == [campaign.id]
    keys = [IdempotencyKeys(cell) for cell in cells]
    for each in keys:
        assert each.claim("same key", "request") is None  # of a service each, not of the plant
    keys[0].release_unanswered()
    assert keys[0].claim("same key", "request") is None
    with pytest.raises(Exception, match="still being processed"):
        keys[1].claim("same key", "request")
    diagnoses = [DiagnosisStore(cell) for cell in cells]
    new = NewDiagnosis(robot_id=own.robot_id, campaigns=(own.id,), axes=("joint_1",), unattended=True)
    begun = diagnoses[0].add(new)
    assert [one.id for one in diagnoses[0].open()] == [begun.id]
    assert diagnoses[1].open() == ()
    diagnoses[1].attend("the service was restarted")
    assert diagnoses[0].diagnosis(begun.id).unattended
    with pytest.raises(OtherMachine, match=f"diagnosis {begun.id} belongs to machine 'cell A'"):
        diagnoses[1].begin(begun.id)


def test_a_stop_and_an_approval_hold_for_their_machine_and_no_other(
    cells: tuple[Database, Database], robot: Robot, specs: Specs
) -> None:
    plan = started(cells[0], robot, specs[0]).plan_id or 0
    (approvals, others), (latch, other) = map(ApprovalStore, cells), map(StopLatch, cells)
    given = approvals.add(plan, "0" * 64, "anna", timedelta(hours=8), lambda: None)
    assert ([one.id for one in approvals.of_plan(plan)], others.of_plan(plan)) == ([given.id], ())
    stop = latch.latch("anna", "smoke")
    assert ([one.id for one in latch.latched()], other.latched()) == ([stop.id], ())
    with pytest.raises(NotFound, match=f"stop {stop.id}"):
        other.reset("berta", [stop.id])
    assert latch.latched() != ()
    latch.reset("anna", [stop.id])
    assert latch.latched() == ()


def test_a_data_folder_has_one_machine(cells: tuple[Database, Database], tmp_path: Path) -> None:
    folder = tmp_path / "data"
    folder.mkdir()
    assert claim_folder(folder, cells[0]) == ""
    assert claim_folder(folder, cells[0]) == ""
    with pytest.raises(ForeignFolder, match=r"belongs to machine 'cell A', not to 'cell B': set `machine_name`"):
        claim_folder(folder, cells[1])


def test_who_owns_no_machine_reads_and_changes_nothing(
    cells: tuple[Database, Database], url: str, robot: Robot, specs: Specs
) -> None:
    campaign = started(cells[0], robot, specs[0])
    with open_database(url, machine=None, migrated=False) as database:
        store = Store(database)
        assert [(one.id, one.here) for one in store.campaigns()] == [(campaign.id, False)]
        for change in (
            lambda: store.move_campaign(campaign.id, campaign_move(CampaignEvent.PAUSE)),
            lambda: store.add_campaign(campaign.plan_id or 0, []),
            lambda: StopLatch(database).latch("anna", "smoke"),
            lambda: MachineLease(database, LEASE_TIME),
        ):
            with pytest.raises(NoMachine, match="only shows the plant; ask the service of the machine"):
                change()


def test_robots_of_one_file_differ_by_serial_number(database: Database, robot: Robot) -> None:
    """A robot that says none keeps the hash that it had before there were any."""
    store = Store(database)
    plain = store.add_robot(robot)
    named = [
        store.add_robot(Robot(robot.description.model_copy(update={"serial": one, "revision": "B"}), robot.urdf_text))
        for one in ("1001", "1002", "1001")
    ]
    assert "serial" not in plain.description.model_dump(mode="json")
    assert (plain.serial, plain.revision) == (None, None)
    assert [(one.serial, one.revision) for one in named] == [("1001", "B"), ("1002", "B"), ("1001", "B")]
    assert (named[0].id, len({plain.id, *(one.id for one in named)})) == (named[2].id, 3)
