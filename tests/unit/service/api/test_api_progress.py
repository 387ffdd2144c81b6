"""Remaining time of a campaign."""

import pytest

from drivers.ports import SweepMode
from service.api.campaigns import progress
from service.recording import Sine, SweepSpec
from service.store.documents import CampaignState, SweepDocument, SweepState


def sweep(number: int, state: SweepState, started_at: float = 0.0) -> SweepDocument:
    """1.5 s to the window of 5 periods of 1 s, 1.5 s out of it: 8 s nominal."""
    spec = SweepSpec(
        id=f"{number:04d}",
        axis="joint_1",
        pose=(0.0,),
        offset_velocity=0.01,
        sines=(Sine(frequency=2.0, amplitude=0.001),),
        period=1.0,
        periods=5,
        measure_from=1.5,
        sample_rate=250.0,
        started_at=started_at,
    )
    return SweepDocument(
        campaign_id=1, number=number, spec=spec, mode=SweepMode.DRIVE_SIDE, state=state, cause="", attempt=1
    )


def test_before_the_first_sweep_the_nominal_durations_count() -> None:
    found = progress(CampaignState.PLANNED, [sweep(n, SweepState.PLANNED) for n in (1, 2, 3)])
    assert (found.done, found.total, found.current) == (0, 3, None)
    assert found.remaining == pytest.approx(24.0)


def test_the_pace_so_far_counts_and_a_pause_does_not() -> None:
    starts = (10.0, 22.0, 34.0, 1034.0, 1046.0)  # every 12 s, one pause
    sweeps = [sweep(n, SweepState.IDENTIFIED, start) for n, start in enumerate(starts, 1)]
    sweeps += [sweep(6, SweepState.RUNNING), sweep(7, SweepState.PLANNED)]
    found = progress(CampaignState.RUNNING, sweeps)
    assert (found.done, found.total) == (5, 7)
    assert found.current == sweeps[5]
    assert found.remaining == pytest.approx(24.0)


def test_a_held_campaign_has_no_remaining_time() -> None:
    assert progress(CampaignState.PAUSED, [sweep(1, SweepState.PLANNED)]).remaining is None


def test_a_failed_sweep_is_not_done_and_a_finished_campaign_has_no_time_left() -> None:
    sweeps = [sweep(1, SweepState.IDENTIFIED, 10.0), sweep(2, SweepState.FAILED)]
    found = progress(CampaignState.COMPLETED, sweeps)
    assert (found.done, found.total, found.remaining) == (1, 2, 0.0)
