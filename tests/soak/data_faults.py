"""What becomes of files: torn by a power cut, rolled back, damaged, locked away; each done to a service at random.

Where a disk has not kept what it said it had kept, the last commits may be gone; what a campaign then has measured is
measured again. What is damaged later is never handed out for what was measured.
"""

import os
import struct
import subprocess
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from random import Random
from typing import Protocol

import httpx

from service.web.client import ServiceClient
from tests.system.rest_bench import PATIENCE, Service

_TAIL = 65536  # bytes of a file that a power cut may leave unwritten, or zeroed
_COMMITS = 6  # of the database that may be lost with it
_FRAME = struct.Struct(">6I")  # of SQLite's write-ahead log: page, pages after a commit, salt (2), checksum (2)
_HEADER = struct.Struct(">8I")  # its head: magic, format, page size, checkpoint, salt (2), checksum (2)


class Files(Protocol):
    """What these faults may lay hands on."""

    service: Service
    client: ServiceClient
    campaign: int
    chance: Random


def torn_stream(bench: Files) -> None:
    """The service dies, and the end of what it was recording is not on the disk, or is zeros."""
    bench.service.kill()
    streams = sorted(
        (bench.service.data / "recordings").glob("campaign-*/*.arrows"), key=lambda path: path.stat().st_mtime
    )
    for stream in streams[-1:]:
        length = stream.stat().st_size
        kept = max(0, length - bench.chance.randrange(1, _TAIL))
        os.truncate(stream, kept)
        if bench.chance.random() < 0.5:
            os.truncate(stream, length)


def lost_commits(bench: Files) -> None:
    """The service dies, and the last commits of its database are not on the disk."""
    bench.service.kill()
    log = bench.service.data / "sweepid.sqlite-wal"
    ends = list(_commits(log))
    if ends:
        lost = bench.chance.randint(1, _COMMITS)
        os.truncate(log, ends[-lost - 1] if len(ends) > lost else _HEADER.size)
        log.with_name("sweepid.sqlite-shm").unlink(missing_ok=True)  # the index of it, made anew from it


def _commits(log: Path) -> Iterator[int]:
    """Where in the log each of its commits ends, bytes; what lies behind them is of an older round."""
    content = log.read_bytes() if log.exists() else b""
    if len(content) < _HEADER.size:
        return
    _, _, page, _, *salt, _, _ = _HEADER.unpack_from(content)
    at = _HEADER.size
    while at + _FRAME.size + page <= len(content):
        _, pages, *found, _, _ = _FRAME.unpack_from(content, at)
        if found != salt:
            return
        at += _FRAME.size + page
        if pages:
            yield at


def damaged_recording(bench: Files) -> None:
    """One recording of the campaign is changed, cut or gone while it is wanted; then it is there again."""
    at = f"{bench.service.url}/api/v1/campaigns/{bench.campaign}/sweeps"
    for sweep in bench.client.sweeps(bench.campaign):
        if sweep["state"] != "identified":
            continue
        recording = _get(f"{at}/{sweep['number']}/recording").json()
        path = bench.service.data / recording["path"]
        whole = path.read_bytes()
        aside = path.with_name(f".{path.name}.aside")
        path.rename(aside)
        try:
            if (changed := _changed(whole, bench.chance)) is not None:
                path.write_bytes(changed)
            answer = _get(f"{at}/{sweep['number']}/recording/file")
            assert answer.status_code == 422, f"sweep {sweep['number']}: a damaged recording was handed out"
        finally:
            aside.replace(path)
        assert _get(f"{at}/{sweep['number']}/recording/file").content == whole
        return


def _changed(whole: bytes, chance: Random) -> bytes | None:
    """With one bit turned, without its end, or not there at all."""
    place = chance.randrange(len(whole))
    turned = whole[:place] + bytes([whole[place] ^ 1 << chance.randrange(8)]) + whole[place + 1 :]
    return chance.choice([turned, whole[:place], None])


def locked_folder(bench: Files) -> None:
    """No file in the folder of the recordings can be made or written for a while."""
    with _immutable(bench.service.data / "recordings"):
        time.sleep(bench.chance.uniform(0.5, 8.0))


@contextmanager
def _immutable(folder: Path) -> Iterator[None]:
    """The folder and all folders in it: also for root, whom permissions do not bind."""
    subprocess.run(["chattr", "-R", "+i", str(folder)], check=False, capture_output=True, timeout=PATIENCE)
    try:
        yield
    finally:
        subprocess.run(["chattr", "-R", "-i", str(folder)], check=True, capture_output=True, timeout=PATIENCE)


def _get(url: str) -> httpx.Response:
    return httpx.get(url, timeout=PATIENCE, trust_env=False)
