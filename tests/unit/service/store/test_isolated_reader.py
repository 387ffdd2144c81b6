"""A bundle is read by another process under limits: whatever becomes of that one, one BadInput says it."""

import asyncio
import os
import resource
import select
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from service import BadInput
from service.model import Recording, Robot, Sweep
from service.store.files.bundle import take_in, write_bundle
from service.store.files.isolated_reader import Limits, read_isolated
from tests.unit.service.store.conftest import Specs

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(sys.platform != "linux", reason="the address space is limited on Linux alone"),
]
LONG = Limits(time=120.0)


@pytest.fixture
def bundle(tmp_path: Path, robot: Robot, specs: Specs) -> Path:
    record = Recording(np.arange(50) / 1000.0, *np.random.default_rng(1).normal(size=(3, 50)))
    write_bundle(tmp_path / "bundle", robot, [Sweep(spec, record) for spec in specs])
    return tmp_path / "bundle"


@pytest.fixture
def work(tmp_path: Path) -> Path:
    path = tmp_path / "work"
    path.mkdir()
    return path


def unfolding(path: Path, rows: int) -> None:
    """Few bytes that unfold to four columns of so many numbers."""
    zeros = pa.array(np.zeros(rows))
    pq.write_table(pa.table(dict.fromkeys(("time", "effort", "velocity", "position"), zeros)), path)


def saved(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.rglob("*") if path.is_file())


async def test_the_samples_lie_in_files_and_the_answer_has_none(bundle: Path, work: Path) -> None:
    answer = await read_isolated(take_in, (bundle, work), "bundle", LONG)
    assert [spec["id"] for spec in answer["sweeps"]] == ["0001", "0002", "0003"]
    assert saved(work / "recordings" / answer["folder"])[::2] == [f"000{n}-1.json" for n in (1, 2, 3)]


async def test_a_file_that_unfolds_beyond_the_limit(bundle: Path, work: Path) -> None:
    unfolding(bundle / "sweeps" / "0003.parquet", 12_000_000)
    assert (bundle / "sweeps" / "0003.parquet").stat().st_size < 2**20
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    with pytest.raises(BadInput, match=f"bundle: .*limit of {700 * 2**20} bytes"):
        await read_isolated(take_in, (bundle, work), "bundle", Limits(memory=700 * 2**20, time=120.0))
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 100 * 2**10  # kB
    assert saved(work) == []


async def test_a_reader_that_hangs_is_ended(bundle: Path, work: Path) -> None:
    stuck(bundle)
    with pytest.raises(BadInput, match="bundle: was not read within the limit of 5 s"):
        await read_isolated(take_in, (bundle, work), "bundle", Limits(time=5.0))
    assert readers() == []


@pytest.mark.parametrize("killed", [True, False], ids=["the reader is killed", "the caller gives up"])
async def test_a_reader_that_is_ended_in_the_middle_leaves_nothing(bundle: Path, work: Path, killed: bool) -> None:
    pipe = stuck(bundle)
    reading = asyncio.create_task(read_isolated(take_in, (bundle, work), "bundle", LONG))
    with await asyncio.to_thread(pipe.open, "wb"):  # opens when the reader has come so far
        (reader,) = readers()
        if killed:
            os.kill(reader, signal.SIGKILL)
            with pytest.raises(BadInput, match=r"SIGKILL; limits 4294967296 bytes of memory and 120 s"):
                await reading
        else:
            reading.cancel()
            with pytest.raises(asyncio.CancelledError):
                await reading
        assert readers() == []
    assert saved(work) == []


async def test_a_description_without_end_is_refused_and_trouble_with_our_own_disk_is_not_the_bundles(
    bundle: Path, work: Path
) -> None:
    with pytest.raises(BadInput, match="more than the limit of 1000 bytes"):
        await read_isolated(take_in, (bundle, work), "bundle", Limits(time=120.0, answer=1000))
    with pytest.raises(NotADirectoryError):
        await read_isolated(take_in, (bundle, Path("/dev/full")), "bundle", LONG)


def test_a_reader_ends_with_the_process_that_asked(bundle: Path, work: Path) -> None:
    pipe = stuck(bundle)
    code = f"""
import asyncio; from pathlib import Path
from service.store.files.isolated_reader import read_isolated; from service.store.files.bundle import take_in
asyncio.run(read_isolated(take_in, (Path({str(bundle)!r}), Path({str(work)!r})), 'bundle'))"""
    with subprocess.Popen([sys.executable, "-c", code]) as asking, pipe.open("wb"):
        (reader,) = readers(asking.pid)
        descriptor = os.pidfd_open(reader)
        asking.kill()
        ended, _, _ = select.select([descriptor], [], [], 60)
        os.close(descriptor)
        assert ended


def stuck(bundle: Path) -> Path:
    """The URDF becomes a pipe: who reads it waits until it is closed."""
    (bundle / "robot.urdf").unlink()
    os.mkfifo(bundle / "robot.urdf")
    return bundle / "robot.urdf"


def readers(parent: int | str = "self") -> list[int]:
    """Children of a process that read."""
    found = Path(f"/proc/{parent}/task").glob("*/children")
    children = [int(child) for path in found for child in path.read_text().split()]
    return [
        child
        for child in children
        if b"service.store.files.isolated_reader" in Path(f"/proc/{child}/cmdline").read_bytes()
    ]
