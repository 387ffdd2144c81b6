"""With the setting `approval` nothing of a plan moves that nobody approved, and not what has changed since."""

import asyncio
import dataclasses
from datetime import timedelta
from pathlib import Path

import pytest
import yaml
from sqlalchemy import text

from drivers.registry import load_profile
from service import BadInput, Conflict, NotFound, NotNow
from service.machine.execution.energising import Approvals
from service.machine.execution.runner import Runner
from service.machine.execution.sweep_executor import SweepExecutor
from service.model.configuration import Box, Cell
from service.planning.compiled_plan import motion_sha256
from service.planning.machine_setup import machine_sha256
from service.process.settings import Settings
from service.store.documents import CampaignState
from service.store.lease_and_latch import ApprovalStore, StopLatch
from tests.unit.service.campaigns.conftest import ROOT, TIMEOUT, Bench, refusing, until

HASH, OTHER = "a" * 64, "b" * 64
HOURS = timedelta(hours=8)


def still() -> None:
    """Nothing came in between."""


class Asked:
    """The bench's runner, as with `approval: true`."""

    def __init__(self, bench: Bench, sha256: str = HASH) -> None:
        self.sha256 = sha256
        self.approvals = Approvals(ApprovalStore(bench.database), needed=True, valid=HOURS)
        executor = SweepExecutor(bench.store, bench.files, bench.machine, bench.hub)
        self.close = executor.close
        self.runner = Runner(
            bench.store,
            bench.machine,
            executor,
            bench.jobs,
            lambda campaign: dataclasses.replace(bench.compile_plan(campaign), sha256=self.sha256),
            self.approvals,
        )


async def test_a_start_and_a_resume_want_an_approval_that_holds(bench: Bench) -> None:
    asked, plan = Asked(bench), bench.campaign.plan_id or 0
    with pytest.raises(Conflict, match=rf"plan {plan} requires the approval of an engineer: not approved yet"):
        await asked.runner.start(bench.campaign.id, bench.intention)
    assert (bench.drive.trace, bench.now.state) == ([], CampaignState.PLANNED)

    asked.approvals.add(plan, HASH, HASH, "ada", still)
    await asked.runner.start(bench.campaign.id, bench.intention)
    await until(lambda: bool(bench.drive.trace))
    stop = await bench.machine.stop("berta", "enough")
    await asyncio.wait_for(asked.runner.finished(), TIMEOUT)
    await bench.machine.reset_stop("berta", [stop.id])
    moved = list(bench.drive.trace)
    asked.sha256 = OTHER
    with pytest.raises(
        Conflict, match=r"by ada of .* is no longer valid: robot, cell, drives, settings or program have changed"
    ):
        await asked.runner.resume(bench.campaign.id, bench.intention, repeat=True)
    assert bench.drive.trace == moved
    assert bench.now.state is CampaignState.PAUSED

    asked.sha256 = HASH
    with pytest.raises(Conflict, match=rf"plan {plan} requires .* by ada of .* was ended by stop \d+ of the machine"):
        await asked.runner.resume(bench.campaign.id, bench.intention, repeat=True)
    assert bench.drive.trace == moved
    asked.approvals.add(plan, HASH, HASH, "ada", still)
    await asked.runner.resume(bench.campaign.id, bench.intention, repeat=True)
    await asyncio.wait_for(asked.runner.finished(), TIMEOUT)
    assert bench.now.state is CampaignState.MEASURED
    await asked.runner.close()
    asked.close()


async def test_a_stop_ends_the_approvals_before_it_and_no_later_one(bench: Bench) -> None:
    """Whether it is stored, released or repeated meanwhile, and whatever the clock says."""
    approvals, plan = Asked(bench).approvals, bench.campaign.plan_id or 0
    first = await bench.machine.stop("berta", "smoke")
    await bench.machine.noted()
    approvals.add(plan, HASH, HASH, "ada", still)
    assert approvals.missing(plan, HASH) == ""
    await bench.machine.reset_stop("berta", [first.id])
    assert approvals.missing(plan, HASH) == ""  # a release ends nothing
    with refusing(bench, "INSERT ON stop"):
        second = await bench.machine.stop("berta", "smoke")
        with pytest.raises(NotNow):
            await bench.machine.reset_stop("berta", [second.id])  # released and never stored, it would end nothing
    await bench.machine.reset_stop("berta", [second.id])
    assert bench.machine.held == ""
    assert "was ended by stop" in approvals.missing(plan, HASH)

    approvals.add(plan, HASH, HASH, "ada", still)
    third = await bench.machine.stop("carla", "fire", source="port")
    await bench.machine.noted()
    approvals.add(plan, HASH, HASH, "ada", still)
    assert approvals.missing(plan, HASH) == ""
    again = await bench.machine.stop("carla", "fire", source="port")
    assert again.id != third.id  # pressed again, the same stop: what was approved between the two is over
    await bench.machine.noted()
    assert "was ended by stop" in approvals.missing(plan, HASH)
    approvals.add(plan, HASH, HASH, "ada", still)
    await bench.machine.reset_stop("carla", [again.id])
    assert approvals.missing(plan, HASH) == ""

    approvals.add(plan, HASH, HASH, "ada", still)
    assert approvals.missing(plan, HASH) == ""
    StopLatch(bench.database).latch("berta", "smoke")
    assert "was ended by stop" in approvals.missing(plan, HASH)


@pytest.mark.parametrize(
    ("shifted", "reason"), [("-8 hours", "expired at"), ("+1 hours", "is in the future: the clock of the computer")]
)
def test_an_approval_holds_for_its_time(bench: Bench, shifted: str, reason: str) -> None:
    approvals, plan = Asked(bench).approvals, bench.campaign.plan_id or 0
    approvals.add(plan, HASH, HASH, "ada", still)
    with bench.database.write() as session:
        session.execute(
            text("UPDATE approval SET at = datetime(at, :by), expires_at = datetime(expires_at, :by)"), {"by": shifted}
        )
    assert reason in approvals.missing(plan, HASH)


def test_what_nobody_looked_at_is_not_approved(bench: Bench) -> None:
    approvals, plan = Asked(bench).approvals, bench.campaign.plan_id or 0
    for number, seen, by, refusal, told in (
        (plan, OTHER, "ada", Conflict, f"review it again \\({HASH}\\)"),
        (plan, HASH, "", BadInput, "approved_by"),
        (plan + 1, HASH, "ada", NotFound, "plan"),
    ):
        with pytest.raises(refusal, match=told):
            approvals.add(number, seen, HASH, by, still)
    assert approvals.of_plan(plan) == ()
    assert "not approved yet" in approvals.missing(plan, "")


def test_all_that_decides_what_moves_is_in_the_hash(bench: Bench, tmp_path: Path) -> None:
    plan, settings, cell = bench.store.plan(bench.campaign.plan_id or 0), Settings(), Cell(name="empty")
    robot = bench.store.robot(plan.robot_id)
    heavier = robot.model_copy(update={"urdf_text": robot.urdf_text.replace('mass value="', 'mass value="1')})
    assert heavier.urdf_text != robot.urdf_text
    (tmp_path / "a.eds").write_text("1")
    (tmp_path / "axis.yaml").write_text(yaml.safe_dump({"eds": "a.eds", "axes": [{"joint": "j", 1: 2}]}))
    profile = load_profile(ROOT / "config" / "drives" / "virtual-max100.yaml")
    small = yaml.safe_load((tmp_path / "axis.yaml").read_text())
    machine = machine_sha256(small, tmp_path)
    box = Box(name="fence", center=(0.0, 0.0, 0.0), size=(1.0, 1.0, 1.0))
    hashes = {
        motion_sha256(plan, robot, cell, settings, machine),
        motion_sha256(plan, heavier, cell, settings, machine),
        motion_sha256(plan.model_copy(update={"document": {"poses": 1}}), robot, cell, settings, machine),
        motion_sha256(plan, robot, cell.model_copy(update={"boxes": (box,)}), settings, machine),
        motion_sha256(plan, robot, cell, settings.model_copy(update={"pose_tolerance": 0.1}), machine),
        motion_sha256(plan, robot, cell, settings.model_copy(update={"machine_name": "cell 2"}), machine),
        motion_sha256(plan, robot, cell, settings, machine_sha256(profile, ROOT / "config" / "drives")),
    }
    (tmp_path / "a.eds").write_text("2")  # a file that the profile names
    hashes.add(motion_sha256(plan, robot, cell, settings, machine_sha256(small, tmp_path)))
    assert len(hashes) == 8
    assert motion_sha256(plan, robot, cell, settings, machine) in hashes
