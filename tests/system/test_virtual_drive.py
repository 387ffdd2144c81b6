"""What `sweepid drive` refuses; tests/contract shows the process on each bus."""

import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
COMMAND = [sys.executable, "-c", "from service.cli import main; main()", "drive"]


@pytest.mark.parametrize(
    ("arguments", "reason"),
    [
        (["--scenario", "nowhere.yaml"], "nowhere.yaml: cannot be read"),
        (["--eds", "{bad}"], "{bad}: not an EDS"),
        (["--fieldbus", "modbus-tcp", "--registers", "nowhere.yaml"], "nowhere.yaml: cannot be read"),
        (["--fieldbus", "modbus-rtu", "--device", "/dev/no-such-line"], "no-such-line"),
    ],
)
def test_bad_arguments_end_with_one_line(arguments: list[str], reason: str, tmp_path: Path) -> None:
    bad = tmp_path / "bad.eds"
    bad.write_text("this is none")
    command = [*COMMAND, *(argument.format(bad=bad) for argument in arguments)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=300, check=False)
    assert (done.returncode, done.stdout) == (2, "")
    assert reason.format(bad=bad) in done.stderr
    assert len(done.stderr.strip().splitlines()) == 1
