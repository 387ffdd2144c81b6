"""The state tables of campaign and sweep: (state, event) -> state; other combinations are refused.

Pure. `docs/reference/states.md` is generated from them (``python -m service.planning.campaigns.state_machine``).
"""

from collections.abc import Callable, Iterable, Mapping
from enum import Enum
from typing import TypeVar

from service import Conflict
from service.store.documents import CampaignState as C, SweepState as S

State = TypeVar("State", bound=Enum)
Event = TypeVar("Event", bound=Enum)


class CampaignEvent(Enum):
    """Events of a campaign."""

    START = "start"  # a person
    PAUSE = "pause"  # a person: after the present sweep
    RESUME = "resume"  # a person
    ABORT = "abort"  # a person: now
    HELD = "held"  # the present sweep is over and a pause was requested
    TROUBLE = "trouble"  # error, stop or end of the service: never continues automatically
    MEASURED = "measured"  # no sweep is left to run, or the required confidence is reached
    IDENTIFIED = "identified"  # no sweep is left to identify


class SweepEvent(Enum):
    """Events of a sweep."""

    BEGIN = "begin"
    RECORD = "record"
    IDENTIFY = "identify"
    FAIL = "fail"
    INTERRUPT = "interrupt"
    SKIP = "skip"  # its campaign was aborted or completed before it ran
    REPEAT = "repeat"  # a person requests another measurement


CAMPAIGN: Mapping[tuple[C, CampaignEvent], C] = {
    (C.PLANNED, CampaignEvent.START): C.RUNNING,
    (C.PLANNED, CampaignEvent.ABORT): C.ABORTED,
    (C.RUNNING, CampaignEvent.PAUSE): C.PAUSING,
    (C.RUNNING, CampaignEvent.ABORT): C.ABORTED,
    (C.RUNNING, CampaignEvent.TROUBLE): C.PAUSED,
    (C.RUNNING, CampaignEvent.MEASURED): C.MEASURED,
    (C.PAUSING, CampaignEvent.RESUME): C.RUNNING,
    (C.PAUSING, CampaignEvent.ABORT): C.ABORTED,
    (C.PAUSING, CampaignEvent.HELD): C.PAUSED,
    (C.PAUSING, CampaignEvent.TROUBLE): C.PAUSED,
    (C.PAUSING, CampaignEvent.MEASURED): C.MEASURED,
    (C.PAUSED, CampaignEvent.RESUME): C.RUNNING,
    (C.PAUSED, CampaignEvent.ABORT): C.ABORTED,
    (C.MEASURED, CampaignEvent.IDENTIFIED): C.COMPLETED,
}

SWEEP: Mapping[tuple[S, SweepEvent], S] = {
    (S.PLANNED, SweepEvent.BEGIN): S.RUNNING,
    (S.PLANNED, SweepEvent.SKIP): S.SKIPPED,
    (S.RUNNING, SweepEvent.RECORD): S.RECORDED,
    (S.RUNNING, SweepEvent.FAIL): S.FAILED,
    (S.RUNNING, SweepEvent.INTERRUPT): S.INTERRUPTED,
    (S.RECORDED, SweepEvent.IDENTIFY): S.IDENTIFIED,
    (S.RECORDED, SweepEvent.FAIL): S.FAILED,
    (S.FAILED, SweepEvent.REPEAT): S.PLANNED,
    (S.INTERRUPTED, SweepEvent.REPEAT): S.PLANNED,
}


def _move(what: str, table: Mapping[tuple[State, Event], State], event: Event) -> Callable[[State], State]:
    def move(state: State) -> State:
        try:
            return table[state, event]
        except KeyError:
            raise Conflict(f"{what}: {event.value} is not possible in state {state.value}") from None

    return move


def campaign_move(event: CampaignEvent) -> Callable[[C], C]:
    """The transition of an event; the returned function raises Conflict if the table has no entry."""
    return _move("campaign", CAMPAIGN, event)


def sweep_move(event: SweepEvent) -> Callable[[S], S]:
    """As `campaign_move`, for a sweep."""
    return _move("sweep", SWEEP, event)


def diagrams() -> str:
    """The reference page: both tables as Mermaid state diagrams."""
    return "\n".join(
        [
            "# States of campaigns and sweeps",
            "",
            (
                "Generated from the tables in `service/planning/campaigns/state_machine.py`; an event without an "
                "arrow is refused."
            ),
            "The machine moves only while a campaign is `running` or `pausing`.",
            "",
            *_diagram("Campaign", C.PLANNED, CAMPAIGN.items()),
            "",
            *_diagram("Sweep", S.PLANNED, SWEEP.items()),
            "",
        ]
    )


def _diagram(title: str, first: Enum, table: Iterable[tuple[tuple[Enum, Enum], Enum]]) -> list[str]:
    arrows = [f"    {state.value} --> {after.value}: {event.value}" for (state, event), after in table]
    return [f"## {title}", "", "```mermaid", "stateDiagram-v2", f"    [*] --> {first.value}", *arrows, "```"]


if __name__ == "__main__":
    import sys

    sys.stdout.write(diagrams())
