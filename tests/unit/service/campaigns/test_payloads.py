"""A payload from two stored campaigns: the job, its result, what is refused, and what a restart continues."""

import asyncio
from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from service import BadInput, Conflict, NotFound
from service.jobs.jobs import Batches
from service.store import tables as t
from service.store.database import Database, open_database
from service.store.diagnoses import ModelStore
from service.store.documents import BatchState, CampaignState
from service.store.files.bundle import Bundle, save_bundle
from service.store.files.data_folder import import_campaign
from service.store.files.recordings import RecordingFiles
from service.store.plant import BatchStore, PayloadDocument
from service.store.store import Store
from sweepid import payload as payload_of
from tests.numeric.free_motion import PAYLOAD, draw, log, program
from tests.unit.service.campaigns.diagnosis_bench import InProcess

TRUTH = draw(4, 3)
PATH = program(np.random.default_rng(4), 3)
BARE = Bundle(TRUTH.robot, tuple(log(TRUTH, PATH, 4)))
LOADED = Bundle(TRUTH.robot, tuple(log(TRUTH.with_payload(PAYLOAD), PATH, 5, started_at=900.0)))
OTHER = Bundle(draw(5, 3).robot, LOADED.sweeps)


@dataclass
class Pairs:
    """Campaigns: 1 bare, 2 loaded, 3 bare again, 4 of another robot, 5 paused; all without a plan but as given."""

    database: Database
    store: Store
    files: RecordingFiles
    batches: BatchStore

    def service(self) -> Batches:
        return Batches(self.store, self.batches, ModelStore(self.database), self.files, InProcess())

    async def over(self, number: int) -> PayloadDocument:
        while (found := self.batches.payload(number)).state is not BatchState.DONE:  # noqa: ASYNC110
            await asyncio.sleep(0.02)
        return found


@pytest.fixture
def pairs(tmp_path: Path) -> Iterator[Pairs]:
    with open_database(f"sqlite:///{tmp_path / 'sweepid.sqlite'}") as database:
        store, files = Store(database), RecordingFiles(tmp_path)
        for bundle in (BARE, LOADED, BARE, OTHER, LOADED):
            import_campaign(store, files, save_bundle(files, bundle))
        with database.write() as session:
            for number in range(1, 6):
                session.get_one(t.CampaignRow, number).state = CampaignState.COMPLETED
            session.get_one(t.CampaignRow, 5).state = CampaignState.PAUSED
        yield Pairs(database, store, files, BatchStore(database))


async def test_a_job_gives_what_the_command_gives_and_once_only(pairs: Pairs) -> None:
    """It is taken up by the next process, and a result that comes twice counts once."""
    asked = pairs.batches.add_payload(1, 2, "Ada")
    assert (asked.state, asked.document, asked.cause) == (BatchState.WAITING, None, "")
    with pytest.raises(Conflict, match="payload 1 has no result: waiting"):
        _ = asked.found
    service = pairs.service()
    await service.recover()
    done = await pairs.over(asked.id)
    command = payload_of(BARE, LOADED)
    assert done.document == command.as_json()
    assert done.found.mass == command.mass
    assert abs((command.mass.value or 0.0) - PAYLOAD[0]) < 4 * (command.mass.std or 0.0)
    assert (done.before, done.after, done.asked_by, done.here) == (1, 2, "Ada", True)
    pairs.batches.add_result(asked.id, 2, 0, {}, cause="again")
    assert pairs.batches.payload(asked.id) == done
    assert pairs.batches.open() == ()
    await service.close()


async def test_why_there_is_no_result_is_stored(pairs: Pairs) -> None:
    service = pairs.service()
    asked = await service.request_payload(1, 3, "Ada")
    found = await pairs.over(asked.id)
    assert (found.document, "no effort differs between the bundles" in found.cause) == (None, True), found.cause
    await service.close()


@pytest.mark.parametrize(
    ("before", "after", "plans", "told"),
    [
        (1, 9, {}, "after: campaign 9 does not exist: name a completed campaign"),
        (9, 2, {}, "before: campaign 9 does not exist: name a completed campaign"),
        (1, 5, {}, "after: campaign 5 is paused, must be completed: let it end, or measure it again"),
        (5, 2, {}, "before: campaign 5 is paused, must be completed"),
        (1, 1, {}, "after: is 1, as `before`: name the campaign with the payload"),
        (1, 4, {}, "after: campaign 4 has robot 2, campaign 1 has robot 1, must be the same"),
        (1, 2, {1: 1, 2: 2}, "after: campaign 2 has plan 2, campaign 1 has plan 1, must be the "
         "same: measure the plan of campaign 1 again with the payload"),
        (1, 2, {1: 1}, "after: campaign 2 has plan none, imported, campaign 1 has plan 1"),
    ],
)  # fmt: skip
def test_campaigns_that_do_not_fit_are_refused(
    pairs: Pairs, before: int, after: int, plans: dict[int, int], told: str
) -> None:
    with pairs.database.write() as session:
        for _ in range(2):
            session.add(t.PlanRow(robot_id=1, document={}))
        session.flush()
        for campaign, plan in plans.items():
            session.get_one(t.CampaignRow, campaign).plan_id = plan
    with pytest.raises(BadInput) as error:
        pairs.batches.add_payload(before, after, "Ada")
    assert str(error.value).startswith(told)
    assert pairs.batches.payloads() == ()


def test_payloads_are_no_jobs_of_reidentification(pairs: Pairs) -> None:
    asked = pairs.batches.add_payload(1, 2, "Ada")
    assert [one.id for one in pairs.batches.payloads()] == [asked.id]
    assert pairs.batches.batches() == ()
    for read in (pairs.batches.batch, pairs.batches.results, partial(pairs.batches.result, campaign_id=2)):
        with pytest.raises(NotFound, match=f"job {asked.id} does not exist"):
            read(asked.id)
    with pytest.raises(NotFound, match="payload 9 does not exist"):
        pairs.batches.payload(9)
