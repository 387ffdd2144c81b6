"""Starting the service where it cannot start."""

import json
import subprocess
import sys
from pathlib import Path


def serve(settings: Path) -> subprocess.CompletedProcess[str]:
    command = [str(Path(sys.executable).with_name("sweepid")), "serve", "--config", str(settings), "--port", "0"]
    return subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)


def test_a_machine_has_one_service(url: str, folder: Path) -> None:
    second = serve(folder / "service.yaml")
    assert (second.returncode, second.stdout) == (1, "")
    last = second.stderr.splitlines()[-1]
    assert last.startswith("sweepid: ")
    assert "machine" in last


def test_a_bad_profile_is_bad_input(tmp_path: Path) -> None:
    settings = tmp_path / "service.yaml"
    settings.write_text(json.dumps({"data_dir": str(tmp_path / "data"), "drive": "no-such-profile.yaml"}), "utf-8")
    refused = serve(settings)
    assert (refused.returncode, refused.stdout) == (2, "")
    assert "no-such-profile.yaml" in refused.stderr.splitlines()[-1]
