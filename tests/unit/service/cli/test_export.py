"""`sweepid export` as a person calls it: files that other tools load, and the values that a control takes."""

import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any, cast

import mujoco
import numpy as np
import pytest

from service import BadInput
from service.formats.export.sheets.inertias import LoadData, load_of
from service.formats.export.sheets.making import check_sheet, fingerprint, sheet
from service.formats.export.sheets.text import as_markdown
from service.model.configuration import read_robot
from service.model.results.estimate import Estimate
from service.model.results.payload import Payload
from service.model.results.sheet import Sheet
from service.store.files.bundle import read_bundle
from tests.command import carried_out, refused, sweepid
from tests.stored.documents import payload, stored
from tests.unit.service.cli.test_identify import INERTIA, bundle

_mujoco = cast(Any, mujoco)  # a binary module without type stubs

__all__ = ["bundle"]  # the fixture

FILES = {"model.urdf", "model.xml", "model.yaml", "robot.yaml"}


@pytest.fixture
def side_file(bundle: Path, tmp_path: Path) -> Path:
    """The bundle's robot as a side file beside its URDF, as a cell has it."""
    description = json.loads((bundle / "bundle.json").read_text())["robot"]
    path = tmp_path / "pair.yaml"
    path.write_text(json.dumps(description | {"urdf": str(bundle / "robot.urdf")}))  # JSON is YAML
    return path


def estimated(bundle: Path, folder: Path) -> Path:
    carried_out("identify", str(bundle), "--json", str(folder / "estimate.json"))
    return folder / "estimate.json"


def test_from_a_bundle_or_an_estimate(bundle: Path, side_file: Path, tmp_path: Path) -> None:
    assert carried_out("export", "model", str(bundle), str(tmp_path / "out")) == f"{tmp_path / 'out'}\n"
    assert {path.name for path in (tmp_path / "out").iterdir()} == FILES
    assert _mujoco.MjModel.from_xml_path(str(tmp_path / "out/model.xml")).dof_damping[0] == pytest.approx(4.0, rel=0.01)
    again = read_robot(tmp_path / "out/robot.yaml")
    assert again.axes[0].viscous_friction == pytest.approx(4.0, rel=0.01)
    assert again.axes[1].motor_inertia is None  # unknown, and not measured

    estimate = estimated(bundle, tmp_path)
    carried_out("export", "model", str(estimate), str(tmp_path / "two"), "--robot", str(side_file))
    for name in FILES:
        assert (tmp_path / "out" / name).read_text() == (tmp_path / "two" / name).read_text()


def test_what_cannot_be_exported_is_told(bundle: Path, side_file: Path, tmp_path: Path) -> None:
    (tmp_path / "no.json").write_text("[1]")
    (tmp_path / "other.json").write_text("{}")
    for arguments, reason in (
        (["no.json", "out"], "--robot: is required with an estimate"),
        (["no.json", "out", "--robot", str(side_file)], "no.json: is not a JSON object"),
        (["other.json", "out", "--robot", str(side_file)], "other.json.axes: Field required"),
        (["missing.json", "out", "--robot", str(side_file)], "missing.json: cannot be read"),
        ([str(bundle), "."], "exists already and is not an empty folder"),
    ):
        places = [str(tmp_path / part) if part.endswith((".json", "out", ".")) else part for part in arguments[:2]]
        assert reason in refused("export", "model", *places, *arguments[2:]).splitlines()[-1]
        assert not (tmp_path / "out").exists()


TOTAL = INERTIA + 1.0  # kg m^2 about the joint, its motor of 1e-4 behind a gear of 100 included
GEAR = 100.0


@pytest.fixture
def made(bundle: Path, tmp_path: Path) -> tuple[Sheet, str]:
    path = tmp_path / "sheet.json"
    done = sweepid("export", "sheet", str(bundle), "--json", str(path))
    assert (done.returncode, done.stderr) == (0, "")
    return read(path), done.stdout


def test_the_truth_comes_out_on_the_side_of_the_motor(made: tuple[Sheet, str]) -> None:
    sheet, text = made
    (axis,) = sheet.axes
    assert axis.identified == pytest.approx(TOTAL, rel=0.01)
    assert axis.cad == pytest.approx(6.0)
    assert axis.motor == pytest.approx(axis.identified / GEAR**2)
    assert axis.motor_std / axis.motor == pytest.approx(0.05, rel=0.3)  # the torque constant's prior rules
    typed = re.search(r"\| j1 \| ([0-9.e-]+) \|", text.partition("MD32650 |")[2])
    assert typed
    assert float(typed[1]) == pytest.approx(TOTAL / GEAR**2, rel=0.01)
    for words in ("MD32620", "S-0-0348", "export model", "Valid for the robot as it was measured", "± std"):
        assert words in text
    assert sheet.poses is not None
    assert sheet.poses["j1"].keys() == {"j1", "j2"}
    assert "- j1 was measured with j1 " in text
    assert not re.search(r" (\S+) \.\.\. \1 (mm|deg)\b", text)  # a joint that stood has one position
    assert text.count("left out. An estimate of the robot contains only combinations") == 2  # loads: KUKA, ABB


@pytest.mark.parametrize(
    "change",
    [
        lambda axis: axis["inertia"][0].update(value=0.0),
        lambda axis: axis.update(torque_gain={"value": 0.0, "std": 0.1}),
        lambda axis: axis.update(torque_gain={"value": 5e-324, "std": 0.1}),
    ],
    ids=["inertia", "gain", "next to 0"],
)
def test_a_value_of_zero_has_no_share_of_std(change: Callable[[dict[str, Any]], object]) -> None:
    document = stored("estimate")
    axis = document["axes"]["joint_2"] | {"confidence_percent": None}
    axis["inertia"] = axis["inertia"][:1]
    change(axis)
    robot = read_robot(Path(__file__).parents[4] / "config/robots/max100-class.yaml")
    document["axes"] = {"joint_2": axis}
    with pytest.raises(BadInput, match=r"e.json axes.joint_2: its inertia or torque_gain has the value 0"):
        sheet(robot, Estimate.read(document, "e.json"), "e.json")


def test_a_ragged_covariance_is_refused(made: tuple[Sheet, str], bundle: Path, tmp_path: Path) -> None:
    path = estimated(bundle, tmp_path)
    document = json.loads(path.read_text("utf-8"))
    document["base"]["covariance"][0] = [1.0, 2.0, 3.0, 4.0, 5.0]
    robot = read_bundle(bundle).robot
    with pytest.raises(BadInput, match=r"e.json base.covariance: must be \d+ x \d+ finite numbers"):
        sheet(robot, Estimate.read(document, "e.json"), "e.json")


def test_a_load_that_was_measured_stands_in_the_words_of_kuka_and_abb(made: tuple[Sheet, str]) -> None:
    text = as_markdown(made[0], load(payload()))
    assert "| 12.00 ± 0.30 | 10, 0, 150 | " in text
    inertia = re.search(r"loaddata measured := \[12,\[10,0,150\],\[(.*?)\],(.*?)\];", text)
    assert inertia
    w, x, y, z = (float(number) for number in inertia[1].split(","))
    moments = [float(number) for number in inertia[2].split(",")]
    rotation = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )
    assert rotation @ np.diag(moments) @ rotation.T == pytest.approx(TENSOR, abs=1e-3)


def test_a_load_stands_in_the_units_of_the_other_controls(made: tuple[Sheet, str]) -> None:
    text = as_markdown(made[0], load(payload()))
    assert "set_target_payload(12, [0.01, 0, 0.15], [0.3, 0.25, 0.2, 0.02, 0, 0.01])" in text
    assert "load_inertia [0.3, 0.02, 0, 0.02, 0.25, 0.01, 0, 0.01, 0.2]" in text  # columns
    assert "| 12 | 1, 0, 15 | 3.059, 2.549, 2.039 |" in text  # FANUC: cm, kgf cm s²
    assert "| 12 | 10, 0, 150 | 0.3, 0.25, 0.2 |" in text  # Yaskawa: mm, kg m²
    assert text.count("Left out, no field: the products of inertia") == 2
    assert "It refuses more than 133 kg m²" not in text
    assert "an axis has no field for mass and centre" in text


TENSOR = np.array([[0.3, 0.02, 0.0], [0.02, 0.25, 0.01], [0.0, 0.01, 0.2]])


def load(document: dict) -> LoadData:
    return load_of(Payload.read(document, "--payload"))


def read(path: Path) -> Sheet:
    return Sheet.read(json.loads(path.read_text("utf-8")), str(path))


def test_a_load_is_read_by_name_whatever_the_order(made: tuple[Sheet, str]) -> None:
    """`sweepid estimate payload` writes xx, xy, yy, xz, yz, zz."""
    turned = payload()
    near = turned["physical"]["nearest"]
    near["inertia"] = {name: near["inertia"][name] for name in ("Ixx", "Ixy", "Iyy", "Ixz", "Iyz", "Izz")}
    assert as_markdown(made[0], load(turned)) == as_markdown(made[0], load(payload()))


@pytest.mark.parametrize("given", [{}, {"mass": None}, {"mass": {"value": 1, "std_total": 1}, "frame": "f"}])
def test_what_is_no_load_is_refused(given: dict) -> None:
    with pytest.raises(BadInput, match="--payload"):
        load(given)


@pytest.mark.parametrize(
    ("figure", "change", "told"),
    [
        ("Izz", {"value": None}, "--payload: lacks Izz"),
        ("mass", {"value": 0.8, "std": 0.3}, "--payload mass: is 0.8 kg, standard deviation 0.3 kg: no mass detected"),
    ],
)
def test_a_load_that_is_known_in_part_or_is_none_is_refused(figure: str, change: dict[str, Any], told: str) -> None:
    known = payload()
    (known["inertia"][figure] if figure == "Izz" else known[figure]).update(change)
    with pytest.raises(BadInput, match=told):
        load(known)


def test_the_fingerprint_is_that_of_the_result_and_tells_what_was_altered(
    made: tuple[Sheet, str], bundle: Path, side_file: Path, tmp_path: Path
) -> None:
    sheet, text = made
    assert sheet.fingerprint in text
    check_sheet(sheet, "sheet")
    estimate, again = estimated(bundle, tmp_path), tmp_path / "again.json"
    told = carried_out("export", "sheet", str(estimate), "--robot", str(side_file), "--json", str(again))
    assert fingerprint(read(again)) == sheet.fingerprint
    assert "make the sheet from the bundle" in told  # for its poses
    (axis,) = sheet.axes
    altered = sheet.model_copy(update={"axes": (axis.model_copy(update={"motor": 1.01 * axis.motor}),)})
    with pytest.raises(BadInput, match="was altered"):
        check_sheet(altered, "sheet")


def test_what_no_body_can_have_and_what_is_hardly_known_is_not_for_use(
    bundle: Path, side_file: Path, tmp_path: Path
) -> None:
    path = estimated(bundle, tmp_path)
    estimate = json.loads(path.read_text("utf-8"))
    estimate["axes"]["j1"]["confidence_percent"] = 40.0
    path.write_text(json.dumps(estimate), encoding="utf-8")
    done = sweepid("export", "sheet", str(path), "--robot", str(side_file))
    assert "Left out: j1, uncertainty 40 %, limit 25 %." in done.stdout
    assert "(no value)" in done.stdout
    estimate["standard_parameters"]["links"]["one"]["m"] = -1.0
    path.write_text(json.dumps(estimate), encoding="utf-8")
    assert "not physically possible for one" in refused("export", "sheet", str(path), "--robot", str(side_file))
    done = sweepid("export", "sheet", str(path))
    assert "--robot: is required with an estimate" in done.stderr


def test_a_later_bundle_is_compared_with_the_sheet(made: tuple[Sheet, str], bundle: Path, tmp_path: Path) -> None:
    sheet, out = tmp_path / "sheet.json", tmp_path / "check.json"
    done = sweepid("check", "sheet", str(sheet), str(bundle))
    assert done.returncode == 0, done.stderr
    assert f"the same as the sheet {made[0].fingerprint}" in done.stdout
    assert "j1: " in done.stdout
    assert "+0.00 %" in done.stdout

    light = json.loads(sheet.read_text("utf-8"))
    for parameter in light["base_parameters"]:
        parameter["value"] *= 0.8
    changed = Sheet.read(light, "sheet")
    light["fingerprint"] = fingerprint(changed)
    (tmp_path / "light.json").write_text(json.dumps(light), "utf-8")
    done = sweepid("check", "sheet", str(tmp_path / "light.json"), str(bundle), "--json", str(out))
    assert done.returncode == 1, done.stderr
    found = json.loads(out.read_text("utf-8"))
    assert (found["verdict"], found["axes"][0]["joint"]) == ("changed", "j1")
    assert found["axes"][0]["differs_percent"] == pytest.approx(25, abs=0.1)


@pytest.mark.parametrize(
    ("arguments", "reason"),
    [
        ((), "name either a bundle or a campaign"),
        (("bundle", "--campaign", "1"), "name either a bundle or a campaign"),
        (("--campaign", "1", "--url", "http://127.0.0.1:9"), "no service at http://127.0.0.1:9"),
    ],
)
def test_what_cannot_be_compared_is_told(
    made: tuple[Sheet, str], tmp_path: Path, arguments: tuple[str, ...], reason: str
) -> None:
    done = sweepid("check", "sheet", str(tmp_path / "sheet.json"), *arguments)
    assert (done.returncode > 0, done.stdout) == (True, "")
    assert reason in done.stderr


def test_a_source_that_does_not_exist_is_named() -> None:
    assert "bundel: cannot be read: No such file" in refused("export", "sheet", "bundel")
