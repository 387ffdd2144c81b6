"""Completions of the shells: what `sweepid --completions` prints, and what a real bash makes of it."""

import os
import subprocess
from pathlib import Path

import pytest

from tests.command import SWEEPID, console, sweepid
from tests.programs import needs

pytestmark = pytest.mark.slow


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_a_script_for_each_shell(shell: str) -> None:
    done = sweepid("--completions", shell)
    assert (done.returncode, done.stderr) == (0, "")
    assert f"_SWEEPID_COMPLETE=complete_{shell}" in done.stdout


def test_a_shell_that_there_is_not() -> None:
    done = sweepid("--completions", "csh")
    assert (done.returncode, done.stdout) == (2, "")
    assert "--completions: unknown shell csh: use bash, zsh or fish" in done.stderr


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
