"""`sweepid commission`: drafts that the loader refuses until they are filled in, a sheet to sign, a move once typed."""

import json
import math
import re
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml
from typer.testing import CliRunner, Result

from drivers.canopen.profile import load_device_map, parse_profile
from drivers.commission.command import commission
from drivers.commission.survey import load
from drivers.commission.units import turned
from drivers.errors import BadProfile
from tests.commission_bench import DRIVES, OWN, Cabinet, cabinet, words_of_energy
from tests.foreign_bench import MAKERS, ROOT, file_of
from tests.planted_mismatches import BOTH, axis

pytestmark = pytest.mark.slow

DEVICES = ROOT / "config" / "devices"
FILLED = {
    "bitrate": 1_000_000, "gear_ratio": 101.0, "rated_torque": 0.5, "position_limits": [-0.2, 0.2], "increments": 8192,
    "velocity_limit": 0.2, "effort_limit": 100.0, "acceleration": 1.0, "quick_stop_deceleration": 4.0, "vendor": 1,
    "product": 2, "revision": 3,
}  # fmt: skip


@pytest.fixture(scope="module", params=BOTH)
def drives(request: pytest.FixtureRequest) -> Iterator[Cabinet]:
    with cabinet(request.param) as bench:
        yield bench


def run(*arguments: object, typed: str = "") -> Result:
    return CliRunner().invoke(commission, [str(each) for each in arguments], input=typed)


def written(bench: Cabinet, folder: Path, **changes: Any) -> Path:
    """The profile as a file, with the files that it names."""
    content = bench.profile | changes
    names = {key: str((DRIVES / content[key]).resolve()) for key in ("eds", "device") if key in content}
    path = folder / "machine.yaml"
    path.write_text(yaml.safe_dump(content | names))
    return path


def filled(value: Any, key: str = "") -> Any:
    """What a person types where a draft says FILL IN; only keys that are in the profile."""
    if isinstance(value, dict):
        return {name: filled(each, name) for name, each in value.items()}
    if isinstance(value, list):
        return [filled(each) for each in value]
    return FILLED[key] if isinstance(value, str) and value.startswith("FILL IN") else value


# -- drafts


def drafted(eds: Path, out: Path, devices: Path, *more: str) -> None:
    done = run("draft", "--eds", eds, "--out", out, "--devices", devices, *more)
    assert done.exit_code == 0, done.output


@pytest.mark.parametrize("maker", ["plain", *MAKERS])
def test_a_draft_names_the_shipped_map_and_is_refused_until_it_is_filled_in(maker: str, tmp_path: Path) -> None:
    eds = file_of(maker)
    out = tmp_path / "drives"
    drafted(eds, out, DEVICES, "--joint", "a", "--joint", "b")
    profile = out / f"{eds.stem}.yaml"
    assert sorted(out.iterdir()) == [profile]
    with pytest.raises(
        BadProfile, match=r"bus\.bitrate: must be filled in: bit/s, .*; \d+ more lines begin with FILL IN"
    ):
        load(profile)
    profile.write_text(yaml.safe_dump(filled(yaml.safe_load(profile.read_text()))))
    assert [(each.joint, each.node) for each in load(profile).axes] == [("a", 1), ("b", 2)]


def test_nothing_is_overwritten(tmp_path: Path) -> None:
    eds = file_of("plain")
    drafted(eds, tmp_path, DEVICES)
    again = run("draft", "--eds", eds, "--out", tmp_path, "--devices", DEVICES)
    assert "nothing is overwritten" in str(again.exception)


def test_a_drive_without_a_map_gets_one_with_a_line_for_each_missing_object(tmp_path: Path) -> None:
    eds = tmp_path / "other.dcf"
    shutil.copy(file_of("powerball"), eds)
    drafted(eds, tmp_path, tmp_path)
    path = tmp_path / "other-device.yaml"
    with pytest.raises(BadProfile, match=r"units\.side: must be filled in: motor, or joint .*; \d+ more lines"):
        load_device_map(path)
    draft = yaml.safe_load(path.read_text())
    assert draft["excitation"] == ["interpolated_position"]
    assert draft["pdos"] == {"set_point": 1, "stop": 2, "state": 1, "place": 2, "unused_tpdos": [3, 4]}
    shipped = yaml.safe_load((DEVICES / "schunk-powerball.yaml").read_text())
    assert set(draft["missing"]) - set(shipped["missing"]) <= {"rated_current", "max_torque", "max_profile_velocity"}
    assert draft["missing"]["error_code"].startswith("FILL IN what replaces it: 603Fh:00")
    draft["units"] = shipped["units"]
    draft["missing"] = dict.fromkeys(draft["missing"], "the maker's manual")
    path.write_text(yaml.safe_dump(draft))
    assert load_device_map(path).units.side == "joint"


def test_a_drive_that_cannot_be_measured_says_what_it_lacks(tmp_path: Path) -> None:
    eds = tmp_path / "s120.eds"
    eds.write_text(re.sub(r"\[(?:6064|607A)\](?:\n.+)*", "", file_of("plain").read_text()))
    done = run("draft", "--eds", eds, "--out", tmp_path / "out", "--devices", tmp_path)
    assert f"{eds}: not in the file: 6064h, 607Ah; without these the drive cannot be used\n" in done.stderr
    assert done.stderr.endswith(f"{eds}: excitation that remains: 60FFh (cyclic_velocity)\n")


@pytest.mark.parametrize("letter", ["\x7f", "\x85", "\u2028"])
def test_a_makers_name_that_yaml_does_not_read_still_makes_a_draft(letter: str, tmp_path: Path) -> None:
    eds = tmp_path / "odd.eds"
    text = file_of("plain").read_text()
    eds.write_text(text.replace("ProductName=", f"ProductName=a{letter}b"), encoding="utf-8")
    drafted(eds, tmp_path, tmp_path)
    with pytest.raises(BadProfile, match="must be filled in"):
        load(tmp_path / "odd.yaml")
    with pytest.raises(BadProfile, match="must be filled in"):
        load_device_map(tmp_path / "odd-device.yaml")


# -- the sheet


def test_a_sound_machine_ends_with_the_line_to_sign(drives: Cabinet, tmp_path: Path) -> None:
    done = run("check", written(drives, tmp_path))
    assert done.exit_code == 0, done.output
    assert "Mismatches: none" in done.output
    assert "machine.yaml  SHA-256 " in done.output
    assert "joint_1: set-points by cyclic_velocity (60FFh)" in done.output
    assert done.output.rstrip().endswith("Signature ____________________")


def test_a_mismatch_is_an_exit_code_and_a_row_of_json(drives: Cabinet, tmp_path: Path) -> None:
    content = axis(rated_torque=1.0)(drives.profile, tmp_path)
    done = run("check", written(drives, tmp_path, axes=content["axes"]), "--json")
    assert done.exit_code == 1
    document = json.loads(done.stdout)
    assert document["sound"] is False
    (wrong,) = [row for row in document["rows"] if row["verdict"] == "MISMATCH"]
    assert (wrong["joint"], wrong["check"]) == ("joint_1", "rated-torque")
    assert set(document["files"]) == {
        "machine.yaml",
        *(Path(content[key]).name for key in ("eds", "device") if key in content),
    }


def test_another_fieldbus_is_refused(tmp_path: Path) -> None:
    error = run("check", DRIVES / "virtual-max100-modbus-tcp.yaml").exception
    assert "adapter: 'modbus' is not supported by this check, only 'canopen' is: check the drives by hand" in str(error)


# -- turned by hand


def by_hand(bench: Cabinet, way: float) -> Callable[[], None]:
    """A hand that turns joint_1 of the machine, whose gear is 171; rad."""

    def turn() -> None:
        node = bench.node()
        node.axis.position += way * 171.0 / math.tau
        if hasattr(node.axis, "_rest"):
            node.axis._rest()
        else:
            node.axis.publish()

    return turn


@pytest.mark.parametrize(
    ("gear", "really", "told"),
    [
        (171.0, 0.5, set()),
        (-171.0, 0.5, {"sign"}),
        (342.0, 0.5, {"gear"}),
        (17.1, 0.5, {"gear"}),
        (171.0, -0.5, {"sign"}),
        (171.0, 0.0, {"turned"}),
    ],
)
def test_a_turn_by_hand_tells_gear_and_sign(
    drives: Cabinet, gear: float, really: float, told: set[str], tmp_path: Path
) -> None:
    drives.heard()
    profile = parse_profile(axis(gear_ratio=gear)(drives.profile, tmp_path), DRIVES)
    with drives.planted(lambda _: None):
        rows = turned(profile, "joint_1", 0.5, by_hand(drives, really))
    assert {row.check for row in rows if row.verdict.value == "MISMATCH"} == told
    assert words_of_energy(drives.heard()) == []


@pytest.mark.parametrize("option", ["joint_1", "joint_1=", "=30", "joint_1=0", "joint_1=nan"])
def test_a_turn_without_a_number_is_refused(option: str, drives: Cabinet, tmp_path: Path) -> None:
    assert "is not JOINT=DEGREES" in str(run("check", written(drives, tmp_path), "--turn", option).exception)


# -- the move


def test_nothing_moves_unless_the_name_is_typed(drives: Cabinet, tmp_path: Path) -> None:
    drives.heard()
    done = run("check", written(drives, tmp_path), "--move", "joint_1", typed="joint_2\n")
    assert isinstance(done.exception, BadProfile)
    assert "'joint_2' was typed, not joint_1; nothing moved" in str(done.exception)
    assert words_of_energy(drives.heard()) == []


def test_nothing_moves_where_anything_does_not_fit(drives: Cabinet, tmp_path: Path) -> None:
    drives.heard()
    content = axis(rated_torque=1.0)(drives.profile, tmp_path)
    done = run("check", written(drives, tmp_path, axes=content["axes"]), "--move", "joint_1", typed="joint_1\n")
    assert done.exit_code == 1
    assert words_of_energy(drives.heard()) == []


def test_the_move_measures_each_channel_and_ends_without_energy(tmp_path: Path) -> None:
    with cabinet(OWN) as bench:
        done = run("check", written(bench, tmp_path), "--json", "--move", "joint_1", typed="joint_1\n")
        assert done.exit_code == 0, done.output
        document = json.loads(done.stdout[done.stdout.index("{") :])  # before it what was typed
        assert document["energy"] == "with a move of joint_1"
        measured = [row["check"] for row in document["rows"] if row["check"] in {"sign", "unit", "delay", "noise"}]
        assert measured == [*["sign"] * 3, *["unit"] * 2, *["delay"] * 2, *["noise"] * 3]
        assert bench.virtual.cabinet.status()["axes"]["joint_1"]["energised"] is False  # pyright: ignore[reportIndexIssue]
