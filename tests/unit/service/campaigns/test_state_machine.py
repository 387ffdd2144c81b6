"""The state tables, exhaustively; and the page that is generated from them."""

from itertools import product
from pathlib import Path
from typing import Any

import pytest

from service.model.errors import Conflict
from service.planning.campaigns.state_machine import (
    CAMPAIGN,
    SWEEP,
    CampaignEvent,
    SweepEvent,
    campaign_move,
    diagrams,
    sweep_move,
)
from service.store.documents import CampaignState, SweepState

PAGE = Path(__file__).parents[4] / "docs" / "reference" / "states.md"

# written out by hand, state by state: what each event leads to; every pair that is not here must be refused
CAMPAIGN_EXPECTED = {
    "planned": {"start": "running", "abort": "aborted"},
    "running": {"pause": "pausing", "abort": "aborted", "trouble": "paused", "measured": "measured"},
    "pausing": {"resume": "running", "abort": "aborted", "held": "paused", "trouble": "paused", "measured": "measured"},
    "paused": {"resume": "running", "abort": "aborted"},
    "measured": {"identified": "completed"},
    "completed": {},
    "aborted": {},
}
SWEEP_EXPECTED = {
    "planned": {"begin": "running", "skip": "skipped"},
    "running": {"record": "recorded", "fail": "failed", "interrupt": "interrupted"},
    "recorded": {"identify": "identified", "fail": "failed"},
    "identified": {},
    "failed": {"repeat": "planned"},
    "interrupted": {"repeat": "planned"},
    "skipped": {},
}


@pytest.mark.parametrize(
    ("state", "event", "move", "expected"),
    [
        *((*pair, campaign_move, CAMPAIGN_EXPECTED) for pair in product(CampaignState, CampaignEvent)),
        *((*pair, sweep_move, SWEEP_EXPECTED) for pair in product(SweepState, SweepEvent)),
    ],
)
def test_every_pair_of_state_and_event(state: Any, event: Any, move: Any, expected: dict[str, dict[str, str]]) -> None:
    after = expected[state.value].get(event.value)
    if after is None:
        with pytest.raises(Conflict, match=f"{event.value} is not possible in state {state.value}"):
            move(event)(state)
    else:
        assert move(event)(state) is type(state)(after)


def test_only_a_person_makes_a_campaign_run() -> None:
    into_running = {event for (_, event), after in CAMPAIGN.items() if after is CampaignState.RUNNING}
    assert into_running == {CampaignEvent.START, CampaignEvent.RESUME}


def test_every_state_can_be_reached() -> None:
    assert {CampaignState.PLANNED, *CAMPAIGN.values()} == set(CampaignState)
    assert {SweepState.PLANNED, *SWEEP.values()} == set(SweepState)


def test_the_page_of_the_states_is_fresh() -> None:
    assert PAGE.read_text(encoding="utf-8") == diagrams(), (
        "run: python -m service.planning.campaigns.state_machine > docs/reference/states.md"
    )
