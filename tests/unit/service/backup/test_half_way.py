"""A run that is killed, or that the disk is too small for, leaves nothing that anybody takes for whole."""

import signal
from pathlib import Path

import pytest

from service.model.errors import BadInput
from service.store.backup import make_backup, restore
from service.store.examination import examine
from tests.unit.service.backup.conftest import Forks, contents

pytestmark = pytest.mark.slow


def test_a_killed_backup_is_none(data: Path, tmp_path: Path, forks: Forks) -> None:
    before = contents(data)
    words = ["data", "backup", str(tmp_path / "backup-N"), "--data-dir", str(data)]
    ended = forks({"words": words, "killed": "backup-N"})["ended"]
    *killed, last = ended
    files = len(before) + 1  # and the manifest
    assert (set(killed), last) == ({-signal.SIGKILL}, 0)
    assert len(killed) > files
    held = set()
    for number in range(1, len(killed) + 1):
        partial = tmp_path / f".backup-{number}.partial"
        assert not (tmp_path / f"backup-{number}").exists()
        held.add(len(contents(partial)) if partial.exists() else 0)
        for place in (partial, tmp_path / f"backup-{number}"):
            with pytest.raises(BadInput, match="is not a complete backup"):
                restore(place, tmp_path / "restored")
    assert held >= set(range(files))  # it was killed at each file
    with pytest.raises(BadInput, match="remove it if no other run is active"):
        make_backup(data / "sweepid.sqlite", data, tmp_path / f"backup-{len(killed)}")
    restore(tmp_path / f"backup-{len(ended)}", tmp_path / "restored")
    assert contents(data) == before


def test_a_killed_restore_leaves_no_data_folder(data: Path, tmp_path: Path, forks: Forks) -> None:
    make_backup(data / "sweepid.sqlite", data, tmp_path / "backup")
    words = ["data", "restore", str(tmp_path / "backup"), "--data-dir", str(tmp_path / "data-N")]
    ended = forks({"words": words, "killed": "data-N"})["ended"]
    assert len(ended) > len(contents(data))
    assert [number for number in range(1, len(ended) + 1) if (tmp_path / f"data-{number}").exists()] == [len(ended)]
    whole = tmp_path / f"data-{len(ended)}"
    assert examine(whole / "sweepid.sqlite", whole, 0) == ()


@pytest.mark.parametrize("command", ["backup", "restore"])
@pytest.mark.parametrize("full_at", ["sweepid.sqlite", "*.parquet"])
def test_a_full_disk_is_one_error_and_leaves_nothing(
    data: Path, tmp_path: Path, forks: Forks, command: str, full_at: str
) -> None:
    database, recording = (min(path.stat().st_size for path in data.rglob(name)) for name in ("*.sqlite", "*.parquet"))
    assert database < recording
    limit = {"sweepid.sqlite": database, "*.parquet": recording}[full_at] - 1
    words = ["data", "backup", str(tmp_path / "new"), "--data-dir", str(data)]
    if command == "restore":
        make_backup(data / "sweepid.sqlite", data, tmp_path / "backup")
        words = ["data", "restore", str(tmp_path / "backup"), "--data-dir", str(tmp_path / "new")]
    before = contents(tmp_path)
    told = forks({"words": words, "limit": limit})
    assert (told["ended"], told["out"], told["err"].count("\n")) == ([1], "", 1)
    assert f"{tmp_path / 'new'} was not written: " in told["err"]
    assert contents(tmp_path) == before
    assert not [path for path in tmp_path.iterdir() if "new" in path.name]
