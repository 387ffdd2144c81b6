"""What is published, as tests make it."""

import json
from datetime import UTC, datetime
from pathlib import Path

import pytest

from service.planning.campaigns.stored_results import AxisEstimateQuality
from service.publishing.state import CampaignProgress, LatestEstimate, LinkParameters, MachineState, PublishedState
from service.store.documents import CampaignState

MADE = datetime(2026, 3, 1, 12, 0, 0, tzinfo=UTC)


@pytest.fixture(scope="session")
def links(root: Path) -> dict[str, dict[str, float]]:
    """The bodies of a stored estimate: the ten parameters of each link."""
    return json.loads((root / "tests" / "stored" / "estimate.json").read_text("utf-8"))["standard_parameters"]["links"]


@pytest.fixture
def state(links: dict[str, dict[str, float]]) -> PublishedState:
    return PublishedState(
        machine=MachineState(
            name="cell 7", connected=True, may_move=True, state="stands", stopped=False, stops=(), reason=""
        ),
        campaign=CampaignProgress(
            id=3, state=CampaignState.RUNNING, cause="", done=1, total=4, sweeps=(2,), axes=("joint_1",)
        ),
        estimate=LatestEstimate(
            robot="max100-class",
            campaign=3,
            revision=1,
            made=MADE,
            condition=None,
            axes={"joint_1": AxisEstimateQuality(sweeps=1, gap=0.1, left=0.01, std=None)},
            links={link: LinkParameters(parameters=parameters) for link, parameters in links.items()},
        ),
    )


def progressed(state: PublishedState, done: int, revision: int = 1) -> PublishedState:
    """Later in the same campaign."""
    assert state.campaign is not None
    assert state.estimate is not None
    campaign = state.campaign.model_copy(update={"done": done})
    estimate = state.estimate.model_copy(update={"revision": revision})
    return state.model_copy(update={"campaign": campaign, "estimate": estimate})
