"""When a campaign may end before its last sweep."""

from service.execution.stop_criterion import confidence_reached


def test_enough_is_every_axis_and_nothing_open() -> None:
    def known(*parameters: str, **percent: float | None) -> dict[str, object]:
        axes = {joint: {"confidence_percent": value} for joint, value in percent.items()}
        return {"base_parameters": parameters, "axes": axes}

    both = ("j1", "j2")
    assert confidence_reached(known("a", "b", j1=0.9, j2=0.5), both, 2, 1.0).endswith(
        "J is known to 0.9 % over the workspace"
    )
    assert confidence_reached(known("a", "b", j1=0.9, j2=1.1), both, 2, 1.0) == ""
    assert confidence_reached(known("a", "b", j1=0.9, j2=None), both, 2, 1.0) == ""
    assert confidence_reached(known("a", "b", j1=0.9), both, 2, 1.0) == ""
    assert confidence_reached(known(), both, 2, 1.0) == ""


def test_enough_is_not_what_is_known_before_every_joint_has_moved() -> None:
    one = {"base_parameters": ["Izz(link_2)"], "axes": {"j2": {"confidence_percent": 1e-5}}}
    assert confidence_reached(one, ("j2",), 4, 1.0) == ""
