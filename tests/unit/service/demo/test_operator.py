"""The operator of `sweepid demo`: goes on after a fault and a suspension, but not after a stop by a person."""

from collections.abc import Iterator
from typing import Any, cast

import pytest

from service.client import HOST_WATCH, Json, ServiceClient, ServiceProblem
from service.demo.operator import CampaignFailed, Operator


class Client:
    """A service whose campaign goes through `states`; a pause has a cause, a stop or a fault."""

    def __init__(self, states: list[str], stopped_by: str) -> None:
        self.states, self.stopped_by = states, stopped_by
        self.did: list[Any] = []

    def start(self, campaign: int) -> None:
        self.did.append(("start", campaign))

    def events(self, campaign: int) -> Iterator[int]:
        yield from range(len(self.states))

    def campaign(self, campaign: int) -> Json:
        return {"state": self.states.pop(0), "cause": "the host was suspended for 3.0 s"}

    def stops(self) -> list[Json]:
        return [{"id": 7, "by": self.stopped_by}, {"id": 8, "by": HOST_WATCH}]

    def reset_stop(self, by: str, stops: list[int]) -> None:
        self.did.append(("release", stops))

    def drives(self) -> Json:
        return {"axes": [{"joint": "joint_1", "fault": None}, {"joint": "joint_2", "fault": "2310h"}]}

    def acknowledge(self, joint: str) -> None:
        self.did.append(("acknowledge", joint))

    def resume(self, campaign: int, *, repeat: bool) -> None:
        if self.stopped_by != HOST_WATCH:
            raise ServiceProblem(409, f"stopped by {self.stopped_by}: a noise")
        self.did.append(("resume", campaign, repeat))

    def stop(self, by: str, why: str) -> None:
        self.did.append(("stop", by, why))


STOP = ("stop", "sweepid demo", "CampaignFailed")
CLEARED = [("release", [7, 8]), ("acknowledge", "joint_2"), ("resume", 1, True)]


@pytest.mark.parametrize(
    ("states", "stopped_by", "did", "ends"),
    [
        (["running", "completed"], HOST_WATCH, [], ""),
        (["paused", "running", "completed"], HOST_WATCH, CLEARED, ""),
        (["paused"], "Ada", [("release", [8]), ("acknowledge", "joint_2"), STOP], "cannot go on: .*by Ada: a noise"),
        (["aborted"], HOST_WATCH, [STOP], "campaign 1 was aborted: the host was suspended"),
        (["paused"] * 4, HOST_WATCH, [*CLEARED * 3, STOP], "paused for the 4th time: the host was suspended"),
    ],
    ids=["to its end", "suspended", "stopped by a person", "aborted", "too many faults"],
)
def test_what_it_clears_and_what_it_leaves_to_a_person(
    states: list[str], stopped_by: str, did: list[Any], ends: str
) -> None:
    client, notes, pauses = Client(list(states), stopped_by), list[str](), min(states.count("paused"), 3)
    operator = Operator(cast("ServiceClient", client), progress=lambda _: None, say=notes.append)
    if ends:
        with pytest.raises(CampaignFailed, match=ends):
            operator.run(1)
    else:
        operator.run(1)
    assert client.did == [("start", 1), *did]
    assert notes == ["the host was suspended for 3.0 s - checked, acknowledged, sweep repeated"] * pauses
