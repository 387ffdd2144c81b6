"""Starting the service where it cannot start."""

import json
import subprocess
import sys
from pathlib import Path

import httpx
import pytest

from service.store.files.recordings import RecordingFiles
from tests.unit.service.api.conftest import serving

pytestmark = pytest.mark.slow


def serve(settings: Path) -> subprocess.CompletedProcess[str]:
    command = [str(Path(sys.executable).with_name("sweepid")), "serve", "--config", str(settings), "--port", "0"]
    return subprocess.run(command, capture_output=True, text=True, check=False)


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


def test_others_are_not_let_in_without_a_login(tmp_path: Path, profile: Path) -> None:
    settings = tmp_path / "service.yaml"
    text = json.dumps({"data_dir": str(tmp_path / "data"), "drive": str(profile), "host": "0.0.0.0"})
    settings.write_text(text, "utf-8")
    refused = serve(settings)
    assert (refused.returncode, refused.stdout, len(refused.stderr.splitlines())) == (2, "", 1)
    assert refused.stderr.startswith("sweepid: host: '0.0.0.0' is reachable from other computers")
    assert not (tmp_path / "data").exists()


def test_a_database_that_is_none_is_told_in_one_line(tmp_path: Path, profile: Path) -> None:
    data = tmp_path / "data"
    data.mkdir()
    (data / "sweepid.sqlite").write_bytes(b"no database at all" * 1000)
    settings = tmp_path / "service.yaml"
    settings.write_text(json.dumps({"data_dir": str(data), "drive": str(profile)}), "utf-8")
    refused = serve(settings)
    assert (refused.returncode, refused.stdout) == (1, "")
    last = refused.stderr.splitlines()[-1]
    assert last.startswith("sweepid: the service did not start: DatabaseError: ")
    assert last.endswith("file is not a database")


def test_what_killed_transfers_left_is_cleared_at_the_start(tmp_path: Path, profile: Path) -> None:
    transfer = RecordingFiles(tmp_path / "data").transfer()
    for name in ("import-x7_a2b3c", "export-0123abcd"):
        (transfer / name / "bundle").mkdir(parents=True)
        (transfer / name / "bundle" / "0001.parquet").write_bytes(bytes(1000))
    with serving(tmp_path, profile) as url:
        assert list(transfer.iterdir()) == []
        assert httpx.get(f"{url}/api/v1/campaigns", trust_env=False).json()["items"] == []
