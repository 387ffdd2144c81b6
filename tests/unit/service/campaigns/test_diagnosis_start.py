"""Which estimate a diagnosis starts from."""

from pathlib import Path
from typing import Any, cast

import pytest

from service.campaigns.state_machine import SweepEvent, sweep_move
from service.diagnosis_loop.starting import Start
from service.estimation import estimate_document, sweep_spectrum
from service.robot import Robot
from service.store.diagnosis_documents import (
    EstimateOf,
)
from service.store.documents import CampaignState
from service.store.files.exchange import campaign_bundle
from tests.unit.service.campaigns.diagnosis_bench import SPECTRUM, Bench, InProcess, axes_of, measured, open_bench

pytestmark = pytest.mark.slow


async def test_the_rigid_model_starts_from_the_robots_latest_estimate_that_is_no_evidence(
    tmp_path: Path, robot: Robot
) -> None:
    worker = InProcess()
    async with open_bench(tmp_path, worker) as bench:
        first, second = (measured(bench.store, bench.files, robot, "joint_1", seed) for seed in (1, 2))
        request = bench.diagnosing.request
        before = await request([second], None, None, unattended=False)
        assert before.estimate is None  # there is none yet
        identified(bench, robot, first, over=False)
        before = await request([second], None, None, unattended=False)
        assert before.estimate is None  # a better one may follow
        bench.store.move_campaign(first, lambda _: CampaignState.COMPLETED)
        told = EstimateOf(campaign_id=first, revision=1)
        other, same, both, asked = [
            await request(campaigns, None, None, unattended=False, start=start)
            for campaigns, start in (
                ([second], Start.ESTIMATE),
                ([first], Start.ESTIMATE),
                ([first, second], Start.ESTIMATE),
                ([second], Start.CAD),
            )
        ]
        assert [one.estimate for one in (other, same, both, asked)] == [told, None, None, None]
        assert bench.diagnoses.diagnosis(other.id).estimate == told
        found = await bench.over(other.id)
        by_cad = await bench.over(asked.id)
        assert found.document is not None, found.cause
        assert by_cad.document is not None, by_cad.cause
        axes = axes_of(found)["joint_1"], axes_of(by_cad)["joint_1"]
        assert [axis["started_from"] for axis in axes] == [f"campaign {first}, revision 1", "cad"]
        assert axes[0]["rigid_model"][0]["nominal"] != axes[1]["rigid_model"][0]["nominal"]


async def test_an_estimate_that_does_not_fit_the_robot_is_passed_over(tmp_path: Path, robot: Robot) -> None:
    async with open_bench(tmp_path, InProcess()) as bench:
        first, second, third = (measured(bench.store, bench.files, robot, "joint_1", seed) for seed in (1, 2, 3))
        identified(bench, robot, first)
        identified(bench, robot, second, {"base_parameters": []})
        diagnosis = await bench.diagnosing.request([third], None, None, unattended=False)
        assert diagnosis.estimate == EstimateOf(campaign_id=first, revision=1)


async def test_a_daily_check_of_one_pose_is_no_start_while_a_better_one_is_there(tmp_path: Path, robot: Robot) -> None:
    async with open_bench(tmp_path, InProcess()) as bench:
        whole, daily, third = (measured(bench.store, bench.files, robot, "joint_1", seed) for seed in (1, 2, 3))
        identified(bench, robot, daily)
        alone = await bench.diagnosing.request([third], None, None, unattended=False)
        identified(bench, robot, whole, confidence=0.5)
        again = measured(bench.store, bench.files, robot, "joint_1", 4)
        identified(bench, robot, again)  # newer than the one that knows J
        both = await bench.diagnosing.request([third], None, None, unattended=False)
    assert alone.estimate == EstimateOf(campaign_id=daily, revision=1)
    assert both.estimate == EstimateOf(campaign_id=whole, revision=1)


def identified(
    bench: Bench,
    robot: Robot,
    campaign: int,
    change: dict[str, Any] | None = None,
    *,
    over: bool = True,
    confidence: float | None = None,
) -> None:
    """The estimate of a campaign, as if it had come with its last sweep; its poses leave J open unless `confidence`."""
    sweeps = campaign_bundle(bench.store, bench.files, campaign).sweeps
    document = estimate_document(robot, [sweep_spectrum(robot, sweep) for sweep in sweeps]).as_json() | (change or {})
    cast("dict[str, Any]", document["axes"])["joint_1"]["confidence_percent"] = confidence
    last = bench.store.sweeps(campaign)[-1]
    assert bench.store.add_estimate([(last, SPECTRUM)], sweep_move(SweepEvent.IDENTIFY), document) is not None
    if over:
        bench.store.move_campaign(campaign, lambda _: CampaignState.COMPLETED)
