"""The warm-up: sweeps before the first that counts, as long as wanted, and without a word on the inertia."""

import pytest
from pydantic import ValidationError

from drivers.ports import SweepMode
from service.identification.design.excitation import Excitation
from service.model.configuration import Cell
from service.model.recording import SweepPurpose
from service.planning.documents import PlanDocument, PlanRequest
from service.planning.plan import build_plan
from service.planning.poses import least_duration
from tests.unit.service.campaigns.small_arm import small_arm


def plan(**fields: object) -> PlanDocument:
    wanted = {"robot_id": 1, "axes": ("j1", "j2"), "varied": ("j1", "j2"), "step": 20.0, "poses": 4} | fields
    return build_plan(small_arm(), PlanRequest.model_validate(wanted), Cell(name="plain", floor=0.0))


def test_all_axes_in_turn_in_the_first_pose_for_the_time_wanted() -> None:
    cold, document = plan(), plan(warm_up=60.0)
    warm = [sweep for sweep in document.sweeps if sweep.spec.purpose is SweepPurpose.WARM_UP]
    assert document.sweeps[: len(warm)] == tuple(warm)
    assert {sweep.spec.pose for sweep in warm} == {document.sweeps[len(warm)].spec.pose}
    assert [sweep.spec.axis for sweep in warm] == ["j1", "j2"] * (len(warm) // 2)
    assert [sweep.spec.repeat for sweep in warm] == [n // 2 for n in range(len(warm))]
    took = sum(sweep.duration for sweep in warm)
    one_round = took / (len(warm) / 2)
    assert 60.0 <= took < 60.0 + 3 * one_round
    assert not any(sweep.spec.shows_inertia for sweep in warm)

    measured = document.sweeps[len(warm) :]
    assert [(s.spec.axis, s.spec.pose, s.spec.sines) for s in measured] == [
        (s.spec.axis, s.spec.pose, s.spec.sines) for s in cold.sweeps
    ]
    assert all(sweep.spec.shows_inertia for sweep in measured)
    starts = [sweep.spec.started_at for sweep in document.sweeps]
    assert starts == sorted(starts)
    assert [sweep.spec.id for sweep in document.sweeps] == [f"{n:04d}" for n in range(1, len(starts) + 1)]


def test_the_one_streamed_sweep_of_an_axis_is_one_that_counts() -> None:
    document = plan(warm_up=30.0, modes="one_host_streamed")
    streamed = [sweep for sweep in document.sweeps if sweep.mode is SweepMode.HOST_STREAMED]
    assert sorted(sweep.spec.axis for sweep in streamed) == ["j1", "j2"]
    assert all(sweep.spec.shows_inertia for sweep in streamed)


def test_none_unless_wanted_and_no_day_long_one() -> None:
    assert all(sweep.spec.purpose is not SweepPurpose.WARM_UP for sweep in plan().sweeps)
    assert least_duration([Excitation(0.01, (), 1.0, 5, 0.5, 0.5)]) > 6.5
    with pytest.raises(ValidationError, match="less than or equal to 7200"):
        plan(warm_up=1e6)
