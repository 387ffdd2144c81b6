"""The console script as a person calls it: exit codes, one line on stderr, results only on stdout."""

import json
import os
import subprocess
import sys
from importlib.metadata import version
from pathlib import Path

import pytest

from service.cli import build
from service.errors import BadInput
from service.geometry.cell import read_cell
from service.store.files.bundle import write_bundle
from tests.command import console, sweepid
from tests.ports import free_port
from tests.recorded_bundle import bundle
from tests.unit.service.test_trace_import import mapping, trace, write_csv

pytestmark = pytest.mark.slow


@pytest.fixture
def plan_file(tmp_path: Path) -> Path:
    path = tmp_path / "plan.json"
    path.write_text(json.dumps({"id": 7}), encoding="utf-8")
    return path


@pytest.mark.parametrize(
    ("arguments", "place"),
    [
        (("measure", "no-such-plan.json"), "no-such-plan.json"),
        (("measure", "\u00b2"), "\u00b2"),
        (("import", "no-such-bundle"), "no-such-bundle"),
        (("plan", "any.yaml", "--axes", "a", "--varied", "b", "--step", "nan"), "--step"),
        (("plan", "no-such-robot.yaml", "--axes", "joint_1", "--varied", "joint_2"), "no-such-robot.yaml"),
        (("serve", "--config", "no-such-settings.yaml"), "no-such-settings.yaml"),
    ],
)
def test_bad_input_is_one_line_and_2(arguments: tuple[str, ...], place: str) -> None:
    done = sweepid(*arguments)
    assert (done.returncode, done.stdout) == (2, "")
    (line,) = done.stderr.splitlines()
    assert place in line


def test_export_refuses_a_folder_with_something_in_it(tmp_path: Path, plan_file: Path) -> None:
    done = sweepid("export", "1", str(tmp_path))
    assert (done.returncode, done.stdout) == (2, "")
    assert str(tmp_path) in done.stderr
    assert list(tmp_path.iterdir()) == [plan_file]


def test_a_service_that_is_not_there_is_1_and_named(plan_file: Path) -> None:
    url = f"http://127.0.0.1:{free_port()}"
    done = console("measure", str(plan_file), "--url", url)
    assert (done.returncode, done.stdout) == (1, "")
    (line,) = done.stderr.splitlines()
    assert f"no service at {url}: start it with `sweepid serve`" in line


def test_a_misspelt_key_is_told_with_the_one_that_was_meant(tmp_path: Path, root: Path) -> None:
    settings = tmp_path / "settings.yaml"
    settings.write_text("data_dirr: var\n", encoding="utf-8")
    done = sweepid("serve", "--config", str(settings))
    assert done.returncode == 2
    assert f"{settings} data_dirr: unknown key; did you mean data_dir?" in done.stderr
    robot = tmp_path / "robot.yaml"
    text = (root / "config/robots/max100-class.yaml").read_text("utf-8")
    robot.write_text(text.replace("gear_ratio:", "gear_ration:"), encoding="utf-8")
    done = sweepid("plan", str(robot), "--axes", "a", "--varied", "b")
    assert "axes.0.gear_ration: unknown key; did you mean gear_ratio?" in done.stderr


def test_what_is_not_there_is_told_with_what_is(root: Path) -> None:
    robots = root / "config" / "robots"
    done = sweepid("plan", str(robots / "max10.yaml"), "--axes", "a", "--varied", "b")
    assert f"{robots} has emps.yaml, max100-class.yaml" in done.stderr
    done = console("drive", "--scenario", str(root / "config/scenarios/nope.yaml"))
    assert done.returncode != 0
    assert "max100-full.yaml" in done.stderr
    with pytest.raises(BadInput, match=r"cell: there is no cell garage in .*cells; there is: workshop"):
        read_cell(root / "config" / "cells" / "garage.yaml")


def test_the_version_and_the_overview_of_own_and_installed_commands_are_told() -> None:
    done = console("--version")
    assert (done.returncode, done.stdout, done.stderr) == (0, f"sweepid {version('sweepid')}\n", "")
    done = console("--help")
    assert done.returncode == 0
    for name in ("demo", "serve", "plan", "measure", "import", "export", "identify", "estimate", "drive"):
        assert f"  {name} " in done.stdout
    for name in ("export", "drive"):  # commands that are the first word of others
        assert "Commands:" in console(name, "--help").stdout


@pytest.mark.parametrize(
    ("former", "now"),
    [
        ("export-sheet", "export sheet"),
        ("import-trace", "import trace"),
        ("payload", "estimate payload"),
        ("jobs show", "plant job"),
        ("jobs list", "plant jobs"),
        ("db prune", "data"),
        ("truth", "drive truth"),
    ],
)
def test_a_former_name_tells_the_present_one_and_runs_nothing(former: str, now: str, tmp_path: Path) -> None:
    done = sweepid(*former.split(), str(tmp_path / "none"))
    assert (done.returncode, done.stdout) == (2, "")
    (line,) = done.stderr.splitlines()
    assert line.endswith(f": is now `sweepid {now}`")


def test_each_former_name_leads_to_a_command() -> None:
    commands, former = build(), build().former
    names = {name for name, _ in commands.every()}
    assert set(former.values()) <= names | {name.partition(" ")[0] for name in names}
    assert not set(former) & names


def test_algebra_runs_on_one_thread() -> None:
    """The console entry says so before NumPy is imported: no thread but the first is there when it is."""
    code = (
        "import os, sys, service.cli\n"
        "assert 'numpy' not in sys.modules\n"
        "sys.argv = ['sweepid', 'plan', '--help']\n"
        "try: service.cli.main()\n"
        "except SystemExit: pass\n"
        "import numpy\n"
        "print(os.environ['OPENBLAS_NUM_THREADS'], len(os.listdir('/proc/self/task')))"
    )
    bare = {key: value for key, value in os.environ.items() if not key.endswith("_NUM_THREADS")}
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, env=bare)
    assert done.stdout.splitlines()[-1] == "1 1"


@pytest.mark.parametrize(
    "arguments",
    [
        ("robot", "check", "config/robots/emps.urdf"),
        ("commission", "draft", "--eds", "config/eds/plain-402.eds"),
        ("export", "recording", "{bundle}"),
        ("import", "trace", "{mapping}"),
    ],
    ids=" ".join,
)
@pytest.mark.parametrize("out", ["{file}/b", "{folder}/" + 300 * "n", "/proc/none"])
def test_a_folder_that_cannot_be_made_is_one_line(
    arguments: tuple[str, ...], out: str, tmp_path: Path, root: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(root)
    (tmp_path / "file").touch()
    write_bundle(tmp_path / "bundle", bundle().robot, bundle().sweeps)
    write_csv(tmp_path / "trace.csv", trace())
    places = {"file": tmp_path / "file", "folder": tmp_path, "bundle": tmp_path / "bundle"}
    given = [one.format(**places, mapping=mapping(tmp_path, "trace.csv")) for one in (*arguments, "--out", out)]
    told = sweepid(*given[: -2 if "export" in given else None], *(given[-1:] if "export" in given else ()))
    assert told.returncode == 2, told.stderr
    assert "cannot be written: " in told.stderr.splitlines()[-1]
    assert not (tmp_path / "b").exists()


def test_a_letter_that_the_terminal_lacks_is_told_as_its_number(tmp_path: Path, root: Path) -> None:
    text = (root / "config/robots/emps.urdf").read_text("utf-8").replace('"slide"', '"\u5173\u8282"')
    (tmp_path / "arm.urdf").write_text(text, encoding="utf-8")
    told = console("robot", "check", str(tmp_path / "arm.urdf"), PYTHONIOENCODING="iso8859-1")
    assert (told.returncode, told.stderr) == (0, "")
    assert r"\u5173\u8282" in told.stdout
