"""The console script as a person calls it: exit codes, one line on stderr, results only on stdout."""

import json
import os
import socket
import subprocess
import sys
from pathlib import Path

import pytest

from tests.command import sweepid

SWEEPID = str(Path(sys.executable).with_name("sweepid"))


def run(*arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run([SWEEPID, *arguments], capture_output=True, text=True, timeout=60, check=False)


def unused_url() -> str:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return f"http://127.0.0.1:{probe.getsockname()[1]}"


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


def test_a_file_nested_too_deeply_is_one_line_and_2(tmp_path: Path) -> None:
    (deep := tmp_path / "deep.yaml").write_text("[" * 5000, encoding="utf-8")
    for arguments in (("plan", str(deep), "--axes", "a", "--varied", "b"), ("measure", str(deep))):
        ended = sweepid(*arguments)
        assert (ended.returncode, ended.stdout, ended.stderr.count("\n")) == (2, "", 1), ended.stderr
        assert "deep.yaml" in ended.stderr


def test_a_port_that_is_taken_is_1_and_named(tmp_path: Path) -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        ended = run("serve", "--port", str(port), "--data-dir", str(tmp_path / "data"))
    assert (ended.returncode, ended.stdout) == (1, "")
    assert f"127.0.0.1:{port}" in ended.stderr.splitlines()[-1]


def test_export_refuses_a_folder_with_something_in_it(tmp_path: Path, plan_file: Path) -> None:
    done = sweepid("export", "1", str(tmp_path))
    assert (done.returncode, done.stdout) == (2, "")
    assert str(tmp_path) in done.stderr
    assert list(tmp_path.iterdir()) == [plan_file]


def test_a_file_that_is_no_plan_is_bad_input(tmp_path: Path) -> None:
    path = tmp_path / "plan.json"
    path.write_text("[1]", encoding="utf-8")
    done = run("measure", str(path))
    assert done.returncode == 2
    assert str(path) in done.stderr


def test_a_service_that_is_not_there_is_1_and_named(plan_file: Path) -> None:
    url = unused_url()
    done = run("measure", str(plan_file), "--url", url)
    assert (done.returncode, done.stdout) == (1, "")
    (line,) = done.stderr.splitlines()
    assert url in line


def test_the_overview_lists_own_and_installed_commands() -> None:
    done = run("--help")
    assert done.returncode == 0
    for name in ("demo", "serve", "plan", "measure", "import", "export", "identify", "import-trace", "drive", "truth"):
        assert f"  {name} " in done.stdout


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
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=True, env=bare
    )
    assert done.stdout.splitlines()[-1] == "1 1"
