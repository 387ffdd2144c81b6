"""`import sweepid`: its examples run, it says what the commands say, and its results show themselves."""

import doctest
import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import sweepid
from service import BadInput
from service.model.results.diagnosis import Diagnosis
from service.model.results.estimate import Estimate
from service.model.results.part import Column, Part, Table
from service.model.results.payload import Payload
from tests.command import sweepid as command
from tests.stored.documents import stored
from tests.unit.service.cli.test_identify import INERTIA, bundle

__all__ = ["bundle"]  # the fixture


@pytest.fixture
def desk(bundle: Path, root: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with a `bundle` and the project's `config`."""
    (bundle.parent / "config").symlink_to(root / "config")
    monkeypatch.chdir(bundle.parent)
    return bundle.parent


def test_the_examples_run(desk: Path) -> None:
    ran = doctest.testmod(sweepid, optionflags=doctest.NORMALIZE_WHITESPACE)
    assert (ran.failed, ran.attempted > 10) == (0, True)


@pytest.mark.parametrize(("name", "face"), [("identify", sweepid.identify), ("check", sweepid.check)])
def test_a_function_writes_the_json_of_the_command(desk: Path, name: str, face: Callable[[str], Part]) -> None:
    told = command(name, "bundle", "--json", "-").stdout
    assert face("bundle").to_json(desk / "kept.json") + "\n" == told == (desk / "kept.json").read_text()


def test_an_estimate_is_a_table_arrays_and_a_frame(desk: Path) -> None:
    found = sweepid.identify("bundle")
    assert found.axes["j1"]["measured"] == pytest.approx([INERTIA + 1] * 4, rel=1e-3)
    assert found["value"].shape == found["std"].shape == (len(found.base_parameters),)
    frame = found.to_pandas()
    assert isinstance(frame, pd.DataFrame)
    assert list(frame) == ["parameter", "CAD", "value", "std"]
    assert frame["value"].to_numpy() == pytest.approx(found["value"])
    for words in ("RMSE of the axis inertias in percent", "Base parameters", "Condition number"):
        assert words in repr(found)
        assert words in found.to_html()


def test_each_kind_of_result_shows_itself() -> None:
    for name, kind in (("estimate", Estimate), ("estimate-free-motion", Estimate), ("analysis", Estimate)):
        found = kind.read(stored(name), name)
        assert len(found.shown()) > 0
        assert "<table>" in found.to_html()
    named = Diagnosis.read(stored("diagnosis-named"), "diagnosis")
    assert named.to_pandas()["verdict"].tolist() == [axis.verdict for axis in named.axes.values()]
    assert all(axis.summary in str(named) for axis in named.axes.values())
    content = stored("diagnosis-named")
    (effect, *_) = next(axis["effects"] for axis in content["axes"].values() if axis["effects"])
    effect["parameters"]["change"] = {"value": 880.0, "std": 640_000.0, "unit": "N m"}
    vague = str(Diagnosis.read(content, "diagnosis"))
    assert ("not significant: change" in vague, "6.4e+05" in vague) == (True, False)


def test_results_draw_themselves() -> None:
    estimate = Estimate.read(stored("estimate"), "estimate")
    for panel, (joint, axis) in zip(estimate.plot(), estimate.axes.items(), strict=True):
        [measured] = panel.containers
        assert panel.get_title() == joint
        assert measured[0].get_ydata() == pytest.approx(axis["measured"])
        assert panel.lines[1].get_ydata() == pytest.approx(axis["identified"])
    [sources] = Estimate.read(stored("estimate-free-motion"), "estimate").plot()
    assert [line.get_label() for line in sources.lines] == [
        "of the model",
        "std by sweeps",
        "by trajectories",
        "together",
    ]
    named = Diagnosis.read(stored("diagnosis-named"), "diagnosis")
    body = Payload.read(stored("payload"), "payload")
    drawn = [panel.containers[0][0].get_ydata() for panel in body.plot()]
    assert np.concatenate(drawn) == pytest.approx(body["value"], nan_ok=True)
    gaps = {line.get_label(): line.get_ydata() for line in named.plot().lines}
    assert gaps == {name: pytest.approx(named[name]) for name in ("before", "after", "noise floor")}


def test_a_plan_draws_its_promise_and_a_bundle_its_efforts(desk: Path) -> None:
    robot = sweepid.read_robot("config/robots/max100-class.yaml")
    plan = sweepid.plan(
        robot, "config/cells/workshop.yaml", axes=["joint_1"], varied=["joint_2", "joint_3"], poses=4, step=20
    )
    [promise] = plan.plot().lines
    assert promise.get_ydata() == pytest.approx([one or np.nan for one in plan.confidence], nan_ok=True)
    measured = sweepid.read_bundle("bundle")
    [panel] = measured.plot()
    assert panel.get_title() == "j1"
    efforts = [line.get_ydata() for line in panel.lines]
    np.testing.assert_array_equal(efforts, [sweep.recording.effort for sweep in measured.sweeps])


def test_a_table_marks_what_is_missing_and_escapes_what_it_shows() -> None:
    table = Table("a < b", (Column("name", ("x", "<i>")), Column("value", (1.23456789, None), ".3g")))
    assert np.isnan(table["value"][1])
    assert str(table).splitlines() == ["a < b", "name  value", "-----------", "x      1.23", "<i>       –"]
    assert "&lt;i&gt;" in table.to_html()
    assert "a &lt; b" in table.to_html()


def test_bundles_without_a_common_motion_are_not_combined(desk: Path) -> None:
    with pytest.raises(BadInput, match="bundle, bundle: has no trajectory"):
        sweepid.combine("bundle", "bundle")


def test_what_is_known_of_an_axis_comes_from_a_file_or_a_mapping(desk: Path) -> None:
    gains = {"axes": {"j1": {"gain": {"value": 1.1, "std": 0.01}}}}
    Path("gains.json").write_text(json.dumps(gains), "utf-8")
    found = sweepid.identify("bundle", torque_gain="gains.json")
    assert found.axes["j1"].torque_gain.value == 1.1
    assert found.axes["j1"]["measured"] == pytest.approx([(INERTIA + 1) / 1.1] * 4, rel=1e-3)


def test_the_client_is_that_of_the_service() -> None:
    from service.web.client import ServiceClient

    assert sweepid.Client is ServiceClient
    with pytest.raises(AttributeError, match="nothing"):
        sweepid.nothing  # noqa: B018
