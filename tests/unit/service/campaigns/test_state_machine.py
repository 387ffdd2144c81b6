"""The state tables: the page that is generated from them, and that nothing else is possible."""

from itertools import product
from pathlib import Path
from typing import Any

import pytest

from service import Conflict
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


@pytest.mark.parametrize(
    ("table", "move", "state", "event"),
    [
        *((CAMPAIGN, campaign_move, *pair) for pair in product(CampaignState, CampaignEvent)),
        *((SWEEP, sweep_move, *pair) for pair in product(SweepState, SweepEvent)),
    ],
)
def test_every_pair_of_state_and_event(table: Any, move: Any, state: Any, event: Any) -> None:
    if (state, event) in table:
        assert move(event)(state) is table[state, event]
    else:
        with pytest.raises(Conflict, match=f"{event.value} is not possible in state {state.value}"):
            move(event)(state)


def test_only_a_person_makes_a_campaign_run() -> None:
    into_running = {event for (_, event), after in CAMPAIGN.items() if after is CampaignState.RUNNING}
    assert into_running == {CampaignEvent.START, CampaignEvent.RESUME}


def test_the_page_of_the_states_is_fresh() -> None:
    """A person has read it: it is the second copy of both tables."""
    assert PAGE.read_text(encoding="utf-8") == diagrams(), (
        "run: python -m service.planning.campaigns.state_machine > docs/reference/states.md"
    )
