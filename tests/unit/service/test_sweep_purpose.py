"""What a sweep is for, and of how many axes its trajectory is: told by the labels that bundles have."""

import pytest

from service.model import SweepPurpose, SweepSpec, together


def spec(excitation: str, block: str = "", offset: float = 0.1) -> SweepSpec:
    told = {"excitation": excitation, "block": block, "offset_velocity": offset}
    return SweepSpec.model_validate({"id": "1", "axis": "j", "pose": (0.0,), "sample_rate": 250.0, **told})


@pytest.mark.parametrize(
    ("sweep", "purpose"),
    [
        (spec("multisine"), SweepPurpose.INERTIA),
        (spec("multisine", "forward"), SweepPurpose.INERTIA),
        (spec("multisine", "reversal", 0.0), SweepPurpose.OTHER),
        (spec("multisine", "stepped_sine_forward"), SweepPurpose.STEPPED_SINE),
        (spec("multisine", "stepped_sine", 0.0), SweepPurpose.STEPPED_SINE),
        (spec("multisine", "warm_up"), SweepPurpose.WARM_UP),
        (spec("multisine", "warm_up_by_hand"), SweepPurpose.INERTIA),
        (spec("trajectory", together(1, 6), 0.0), SweepPurpose.INERTIA),
        (spec("trajectory", "stepped_sine"), SweepPurpose.INERTIA),
        (spec("trajectory", "warm_up"), SweepPurpose.WARM_UP),
        (spec("noise", "noise_forward"), SweepPurpose.OTHER),
        (spec("noise", "stepped_sine"), SweepPurpose.OTHER),
        (spec("standstill", "hold", 0.0), SweepPurpose.OTHER),
    ],
)
def test_the_purpose_of_a_sweep(sweep: SweepSpec, purpose: SweepPurpose) -> None:
    assert sweep.purpose is purpose
    assert sweep.shows_inertia == (purpose is SweepPurpose.INERTIA)
    assert sweep.stepped == (purpose is SweepPurpose.STEPPED_SINE)


@pytest.mark.parametrize(
    ("block", "axes"),
    [(together(3, 6), 6), (together(12, 1), 1), ("trajectory 1 of six axes", 1), ("trajectory 1 of 6", 1), ("", 1)],
)
def test_of_how_many_axes_a_trajectory_is(block: str, axes: int) -> None:
    assert spec("trajectory", block).axes_at_once == axes


def test_a_purpose_is_not_written() -> None:
    assert "purpose" not in spec("multisine", "warm_up").model_dump(mode="json")
