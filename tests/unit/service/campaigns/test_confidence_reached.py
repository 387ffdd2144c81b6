"""A campaign that wants a confidence ends when its estimates have it, and measures all where they never do."""

import dataclasses

import pytest

from service.campaigns.state_machine import SweepEvent, sweep_move
from service.store.documents import CampaignState, SweepDocument, SweepState
from tests.stored.documents import stored
from tests.unit.service.campaigns.conftest import SPECTRUM, Bench

pytestmark = pytest.mark.slow


def wants_confidence(bench: Bench, reached: list[float | None]) -> None:
    """The plan wants 1 %; the estimates, which come at once, have `reached` so many percent after each sweep."""
    known, compile_plan = stored("estimate"), bench.compile_plan
    bench.compile_plan = lambda campaign: dataclasses.replace(compile_plan(campaign), confidence=1.0, base_parameters=1)

    def identify(sweep: SweepDocument) -> None:
        axis = known["axes"]["joint_1"] | {"confidence_percent": reached.pop(0)}
        document = known | {"base_parameters": known["base_parameters"][:1], "axes": {"joint_1": axis}}
        bench.store.add_estimate([(sweep, SPECTRUM)], sweep_move(SweepEvent.IDENTIFY), document)

    bench.jobs.submit = identify


async def test_a_campaign_ends_when_enough_is_known(bench: Bench) -> None:
    wants_confidence(bench, [None, 0.8])
    await bench.start()
    campaign = await bench.over()
    why = "confidence of 1 % reached: J is known to 0.8 % over the workspace"
    assert (campaign.state, campaign.cause) == (CampaignState.COMPLETED, why)
    assert campaign.sweeps == {SweepState.IDENTIFIED: 2, SweepState.SKIPPED: 2}
    assert bench.store.sweep(campaign.id, 3).cause == why
    assert sum(entry.startswith("sweep") for entry in bench.drive.trace) == 2


async def test_a_campaign_that_does_not_know_enough_runs_to_its_end(bench: Bench) -> None:
    wants_confidence(bench, [None, 1.2, 1.1, 1.01])
    await bench.start()
    campaign = await bench.over()
    assert (campaign.state, campaign.cause) == (CampaignState.COMPLETED, "")
    assert campaign.sweeps == {SweepState.IDENTIFIED: 4}
