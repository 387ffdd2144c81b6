"""When a campaign that wants a confidence ends before its last sweep; it measures all where that is not reached."""

import dataclasses

import pytest

from service.model.results.estimate import BaseParameter, Estimate
from service.planning.campaigns.state_machine import SweepEvent, sweep_move
from service.planning.campaigns.stored_results import confidence_reached
from service.store.documents import CampaignState, SweepDocument, SweepState
from tests.stored.documents import stored
from tests.unit.service.campaigns.conftest import SPECTRUM, Bench


def wants_confidence(bench: Bench, reached: list[float | None]) -> None:
    """The plan wants 1 %; the estimates, which come at once, have `reached` so many percent after each sweep."""
    known, compile_plan = stored("estimate"), bench.compile_plan
    bench.compile_plan = lambda campaign: dataclasses.replace(compile_plan(campaign), confidence=1.0, base_parameters=1)

    def identify(sweep: SweepDocument) -> None:
        axis = known["axes"]["joint_1"] | {"confidence_percent": reached.pop(0)}
        document = known | {"base_parameters": known["base_parameters"][:1], "axes": {"joint_1": axis}}
        bench.store.add_estimate([(sweep, SPECTRUM)], sweep_move(SweepEvent.IDENTIFY), document)

    bench.jobs.submit = identify


@pytest.mark.slow
@pytest.mark.parametrize(
    ("reached", "cause", "sweeps"),
    [
        ([None, 0.8], "confidence of 1 % reached: J is known to 0.8 % over the workspace", {SweepState.SKIPPED: 2}),
        ([None, 1.2, 1.1, 1.01], "", {}),
    ],
)
async def test_a_campaign_ends_when_enough_is_known(
    bench: Bench, reached: list[float | None], cause: str, sweeps: dict[SweepState, int]
) -> None:
    count = len(reached)
    wants_confidence(bench, reached)
    await bench.start()
    campaign = await bench.over()
    assert (campaign.state, campaign.cause) == (CampaignState.COMPLETED, cause)
    assert campaign.sweeps == {SweepState.IDENTIFIED: count} | sweeps
    assert {sweep.cause for sweep in bench.store.sweeps(campaign.id)[count:]} == ({cause} if cause else set())
    assert sum(entry.startswith("sweep") for entry in bench.drive.trace) == count


def known(*parameters: str, **percent: float | None) -> Estimate:
    """An estimate of these base parameters, with these axes known so well."""
    found = Estimate.read(stored("estimate"), "estimate")
    axis = found.axes["joint_1"]
    axes = {joint: axis.model_copy(update={"confidence_percent": value}) for joint, value in percent.items()}
    base = tuple(BaseParameter(name=name, value=1.0, std=0.1) for name in parameters)
    return found.model_copy(update={"axes": axes, "base_parameters": base})


@pytest.mark.parametrize(
    ("parameters", "percent", "joints", "wanted", "told"),
    [
        (("a", "b"), {"j1": 0.9, "j2": 0.5}, ("j1", "j2"), 2, "J is known to 0.9 % over the workspace"),
        (("a", "b"), {"j1": 0.9, "j2": 1.1}, ("j1", "j2"), 2, ""),
        (("a", "b"), {"j1": 0.9, "j2": None}, ("j1", "j2"), 2, ""),
        (("a", "b"), {"j1": 0.9}, ("j1", "j2"), 2, ""),
        ((), {}, ("j1", "j2"), 2, ""),
        (("Izz(link_2)",), {"j2": 1e-5}, ("j2",), 4, ""),  # what is known before every joint has moved
    ],
)
def test_enough_is_every_axis_and_nothing_open(
    parameters: tuple[str, ...], percent: dict[str, float | None], joints: tuple[str, ...], wanted: int, told: str
) -> None:
    assert confidence_reached(known(*parameters, **percent), joints, wanted, 1.0).rpartition(": ")[2] == told
