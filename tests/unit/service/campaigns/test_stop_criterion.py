"""When a campaign may end before its last sweep."""

from service.campaigns.stop_criterion import confidence_reached
from service.results.estimate import BaseParameter, Estimate
from tests.stored.documents import stored


def known(*parameters: str, **percent: float | None) -> Estimate:
    """An estimate of these base parameters, with these axes known so well."""
    found = Estimate.read(stored("estimate"), "estimate")
    axis = found.axes["joint_1"]
    axes = {joint: axis.model_copy(update={"confidence_percent": value}) for joint, value in percent.items()}
    base = tuple(BaseParameter(name=name, value=1.0, std=0.1) for name in parameters)
    return found.model_copy(update={"axes": axes, "base_parameters": base})


def test_enough_is_every_axis_and_nothing_open() -> None:
    both = ("j1", "j2")
    assert confidence_reached(known("a", "b", j1=0.9, j2=0.5), both, 2, 1.0).endswith(
        "J is known to 0.9 % over the workspace"
    )
    assert confidence_reached(known("a", "b", j1=0.9, j2=1.1), both, 2, 1.0) == ""
    assert confidence_reached(known("a", "b", j1=0.9, j2=None), both, 2, 1.0) == ""
    assert confidence_reached(known("a", "b", j1=0.9), both, 2, 1.0) == ""
    assert confidence_reached(known(), both, 2, 1.0) == ""


def test_enough_is_not_what_is_known_before_every_joint_has_moved() -> None:
    assert confidence_reached(known("Izz(link_2)", j2=1e-5), ("j2",), 4, 1.0) == ""
