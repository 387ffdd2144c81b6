"""The console script as a person calls it: exit codes, what goes where, completions, a terminal."""

import json
import os
import pty
import re
import subprocess
import sys
from importlib.metadata import version
from pathlib import Path

import pytest

from service import BadInput
from service.cli import build
from service.model.configuration import read_cell
from service.store.files.bundle import write_bundle
from tests.command import SWEEPID, carried_out, console, refused, sweepid
from tests.ports import free_port
from tests.programs import needs
from tests.recorded_bundle import bundle as recorded
from tests.unit.service.cli.test_identify import bundle
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


def test_a_service_that_is_not_there_is_1_and_named(plan_file: Path) -> None:
    url = f"http://127.0.0.1:{free_port()}"
    done = console("measure", str(plan_file), "--url", url)
    assert (done.returncode, done.stdout) == (1, "")
    (line,) = done.stderr.splitlines()
    assert f"no service at {url}: start it with `sweepid serve`" in line


def test_a_misspelt_key_is_told_with_the_one_that_was_meant(tmp_path: Path, root: Path) -> None:
    settings = tmp_path / "settings.yaml"
    settings.write_text("data_dirr: var\n", encoding="utf-8")
    assert f"{settings} data_dirr: unknown key; did you mean data_dir?" in refused("serve", "--config", str(settings))
    robot = tmp_path / "robot.yaml"
    text = (root / "config/robots/max100-class.yaml").read_text("utf-8")
    robot.write_text(text.replace("gear_ratio:", "gear_ration:"), encoding="utf-8")
    done = sweepid("plan", str(robot), "--axes", "a", "--varied", "b")
    assert "axes.0.gear_ration: unknown key; did you mean gear_ratio?" in done.stderr


def test_what_is_not_there_is_told_with_what_is(root: Path) -> None:
    robots = root / "config" / "robots"
    done = sweepid("plan", str(robots / "max10.yaml"), "--axes", "a", "--varied", "b")
    assert f"{robots} has emps.yaml, max100-class.yaml" in done.stderr
    done = sweepid("drive", "--scenario", str(root / "config/scenarios/nope.yaml"))
    assert done.returncode != 0
    assert "max100-full.yaml" in done.stderr
    with pytest.raises(BadInput, match=r"cell: there is no cell garage in .*cells; there is: workshop"):
        read_cell(root / "config" / "cells" / "garage.yaml")


def test_the_version_and_the_overview_of_own_and_installed_commands_are_told() -> None:
    done = console("--version")
    assert (done.returncode, done.stdout, done.stderr) == (0, f"sweepid {version('sweepid')}\n", "")
    done = console("--help")
    assert done.returncode == 0
    words = re.findall(r"^  (\S+)  ", done.stdout.partition("Commands:")[2], re.MULTILINE)
    assert " ".join(words) == (  # by task; the others are words below these
        "demo serve plan measure import check identify diagnose estimate report export robot plant data people audit "
        "commission drive"
    )
    for name in ("export", "drive"):  # commands that are the first word of others
        assert "Commands:" in carried_out(name, "--help")


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


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_a_script_for_each_shell(shell: str) -> None:
    done = sweepid("--completions", shell)
    assert (done.returncode, done.stderr) == (0, "")
    assert f"_SWEEPID_COMPLETE=complete_{shell}" in done.stdout
    assert "--completions: unknown shell csh: use bash, zsh or fish" in refused("--completions", "csh")


@needs("bash")
@pytest.mark.parametrize(
    ("line", "expected", "unexpected"),
    [
        ("sweepid export s", {"sheet"}, {"model", "plan"}),
        ("sweepid drive", {"drive"}, {"plan"}),  # of another package, by entry point
        ("sweepid export sheet --kuka", {"--kuka-upright"}, {"--robot"}),
        ("sweepid people add", {"add-key", "add-user"}, {"revoke-key"}),
    ],
)
def test_bash_completes(line: str, expected: set[str], unexpected: set[str], tmp_path: Path) -> None:
    script = tmp_path / "completions.bash"
    script.write_text(sweepid("--completions", "bash").stdout, "utf-8")
    words = line.split()
    given = f"""
        source {script}
        function_of() {{ complete -p sweepid | sed 's/.*-F \\([^ ]*\\) .*/\\1/'; }}
        COMP_WORDS=({" ".join(words)}); COMP_CWORD={len(words) - 1}
        $(function_of) sweepid
        printf '%s\\n' "${{COMPREPLY[@]}}"
    """
    environment = os.environ | {"PATH": f"{Path(SWEEPID).parent}:{os.environ['PATH']}"}
    done = subprocess.run(
        ["bash", "--norc", "-c", given], capture_output=True, text=True, timeout=120, check=False, env=environment
    )
    offered = set(done.stdout.split())
    assert expected <= offered, done.stdout + done.stderr
    assert not offered & unexpected


def test_zsh_and_fish_ask_with_the_whole_line() -> None:
    for shell in ("zsh", "fish"):
        done = console(
            _SWEEPID_COMPLETE=f"complete_{shell}",
            _TYPER_COMPLETE_ARGS="sweepid export s",
            _TYPER_COMPLETE_FISH_ACTION="get-args",
        )
        assert "sheet" in done.stdout, done.stderr
        assert "payload" not in done.stdout


def test_command_names_load_no_command() -> None:
    """A person presses Tab often: names come without NumPy."""
    asked = {"_SWEEPID_COMPLETE": "complete_bash", "COMP_WORDS": "sweepid exp", "COMP_CWORD": "1"}
    done = console(**asked, PYTHONPROFILEIMPORTTIME="1")
    assert "export" in done.stdout
    assert "| typer" in done.stderr  # what is imported is told
    assert "| numpy" not in done.stderr


__all__ = ["bundle"]  # the fixture


def on_a_terminal(*arguments: str) -> tuple[int, str, str]:
    """Exit code, stdout, and what a terminal at stderr was shown."""
    ours, theirs = pty.openpty()
    with subprocess.Popen(
        [SWEEPID, *arguments], stdout=subprocess.PIPE, stderr=theirs, env=os.environ | {"TERM": "xterm"}
    ) as process:
        os.close(theirs)
        shown = b""
        try:
            while piece := os.read(ours, 4096):
                shown += piece
        except OSError:  # the other side is closed
            pass
        out = process.stdout.read() if process.stdout else b""
    os.close(ours)
    return process.returncode, out.decode(), shown.decode()


@pytest.mark.parametrize(
    ("command", "line"),
    [("check", "checking the data"), ("diagnose", "diagnosing"), ("identify", "reading the bundle")],
)
def test_a_terminal_shows_what_is_waited_for(bundle: Path, command: str, line: str) -> None:
    code, out, shown = on_a_terminal(command, str(bundle), "--json", "-")
    assert (code, out[:1]) == (0, "{"), shown
    assert line in shown
    assert line not in out


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
    write_bundle(tmp_path / "bundle", recorded().robot, recorded().sweeps)
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
