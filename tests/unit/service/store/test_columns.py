"""Samples as Parquet and CSV: what is written comes back to the last bit, what is no sample is refused by name."""

import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import given, settings, strategies as st
from hypothesis.extra import numpy as hnp

from service import BadInput
from service.model import OPTIONAL_COLUMNS, REQUIRED_COLUMNS, Recording
from service.store.files.columns import LARGEST_CSV, MOST_NUMBERS, read_columns, read_table, write_columns

PLAIN = "time,effort,velocity,position\n0,1,2,3\n0.5,1,2,3\n"


PEAK = """
import sys
from pathlib import Path
import pyarrow
from service import BadInput
from service.store.files.columns import read_columns
try:
    read_columns(Path(sys.argv[1]))
except BadInput as error:
    print(error, file=sys.stderr)
print(pyarrow.default_memory_pool().max_memory())
"""


def peak_of_reading(path: Path) -> tuple[int, str]:
    """Bytes that pyarrow needed at most in a process that read nothing else, and why the file was refused."""
    done = subprocess.run([sys.executable, "-c", PEAK, str(path)], check=True, capture_output=True, text=True)
    return int(done.stdout), done.stderr


@st.composite
def recordings(draw: st.DrawFn) -> Recording:
    count = draw(st.integers(2, 30))
    column = hnp.arrays(np.float64, count, elements=st.floats(allow_nan=False, allow_infinity=False))
    optional = {name: draw(column) for name in OPTIONAL_COLUMNS if draw(st.booleans())}
    return Recording(
        np.arange(count) / draw(st.sampled_from([3.0, 250.0, 1000.0])), *(draw(column) for _ in range(3)), **optional
    )


@pytest.mark.parametrize("suffix", [".parquet", ".csv"])
@settings(max_examples=40, deadline=None)
@given(recording=recordings())
def test_round_trip_is_exact(tmp_path_factory: pytest.TempPathFactory, suffix: str, recording: Recording) -> None:
    path = tmp_path_factory.mktemp("columns") / f"sweep{suffix}"
    write_columns(path, recording)
    back = read_columns(path)
    for name in (*REQUIRED_COLUMNS, *OPTIONAL_COLUMNS):
        ours, theirs = getattr(recording, name), getattr(back, name)
        assert (ours is None) == (theirs is None), name
        if ours is not None:
            np.testing.assert_array_equal(theirs, ours)


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        (PLAIN.replace("effort", "torque"), "column 'effort' is missing; there are time, torque, velocity, position"),
        (PLAIN.replace("position", "effort"), "column 'position' is missing"),
        (PLAIN.replace("time", "time,effort").replace("\n0", "\n0,9"), "column 'effort' occurs twice"),
        (PLAIN.replace(",1,2,3\n0.5", ",nan,2,3\n0.5"), "column 'effort' is nan in row 1"),
        (PLAIN.replace("0.5,1,2,", "0.5,1,2,inf"), "column 'position' is inf in row 2"),
        (PLAIN.replace("0.5,1", "0.5,"), "column 'effort' is nan in row 2"),
        (PLAIN.replace("0.5,1", "0.5,one"), "column 'effort' holds string, not numbers"),
        (PLAIN.replace("0.5", "0"), "time does not increase at row 2: 0.0 s after 0.0 s"),
        (PLAIN.replace("0.5", "-1"), "time does not increase at row 2"),
        (PLAIN.replace("\n0,", "\n0.2,").replace("0.5", "0.4"), "time starts at 0.2 s"),
        (PLAIN.rsplit("0.5")[0], "has 1 samples"),
        ("", "cannot be read"),
        (PLAIN + "7,8\n", "cannot be read"),
    ],
)
def test_refusals_name_the_reason(tmp_path: Path, text: str, reason: str) -> None:
    path = tmp_path / "sweep.csv"
    path.write_text(text.replace("inf3", "inf"))
    with pytest.raises(BadInput) as refusal:
        read_columns(path, "the sweep")
    assert refusal.value.place == "the sweep"
    assert refusal.value.reason.startswith(reason)


def torn(path: Path) -> None:
    write_columns(path, Recording(*(np.arange(1000.0) for _ in range(4))))
    path.write_bytes(path.read_bytes()[:-100])


def with_a_hole(path: Path) -> None:
    columns = {name: [0.0, 1.0] for name in REQUIRED_COLUMNS} | {"load_position": [None, 1.0]}
    pq.write_table(pa.table(columns), path)


def too_large(path: Path) -> None:
    with path.open("wb") as file:
        file.truncate(LARGEST_CSV + 1)


@pytest.mark.parametrize(
    ("name", "make", "told"),
    [
        ("torn.parquet", torn, "cannot be read"),
        ("hole.parquet", with_a_hole, "'load_position' is nan in row 1"),
        ("large.csv", too_large, f"limit {LARGEST_CSV} bytes"),
        *((name, None, None) for name in ("sweep.txt", "missing.csv", "missing.parquet", ".")),
    ],
)
def test_files_that_are_none_are_refused(
    tmp_path: Path, name: str, make: Callable[[Path], None] | None, told: str | None
) -> None:
    if make is not None:
        make(tmp_path / name)
    with pytest.raises(BadInput, match=told):
        read_columns(tmp_path / name)


def test_nothing_unreadable_is_written(tmp_path: Path) -> None:
    good = np.arange(3.0)
    for bad in (Recording(good, good, good, good[:2]), Recording(good, good, np.array([0, np.nan, 1]), good)):
        with pytest.raises(BadInput):
            write_columns(tmp_path / "sweep.parquet", bad)
    with pytest.raises(BadInput, match="parquet or"):
        write_columns(tmp_path / "sweep.txt", Recording(good, good, good, good))
    assert list(tmp_path.iterdir()) == []


@pytest.mark.slow
def test_a_small_file_with_very_long_columns_is_refused_before_it_is_read(tmp_path: Path) -> None:
    """Each column is one value many times over: 50 MB of numbers in far less than 1 MB."""
    path = tmp_path / "long.parquet"
    rows = MOST_NUMBERS // 20
    group = pa.table({name: pa.array(np.zeros(rows)) for name in REQUIRED_COLUMNS})
    with pq.ParquetWriter(path, group.schema) as writer:
        for _ in range(6):
            writer.write_table(group)
    assert path.stat().st_size < 1_000_000
    before = pa.total_allocated_bytes()
    with pytest.raises(BadInput, match=f"holds {6 * rows} rows of 4 columns, limit {MOST_NUMBERS} numbers"):
        read_columns(path)
    assert pa.total_allocated_bytes() - before < 10_000_000


@pytest.mark.slow
def test_columns_that_nobody_asked_for_are_not_read(tmp_path: Path) -> None:
    path = tmp_path / "wide.parquet"
    time = np.arange(1000) / 1000
    table = pa.table(dict.fromkeys(REQUIRED_COLUMNS, time) | {"note": ["x" * 100_000] * 1000})
    pq.write_table(table, path)
    peak, refused = peak_of_reading(path)
    assert refused == ""
    assert 0 < peak < 10_000_000


@pytest.mark.slow
@pytest.mark.parametrize("end", [b"\n", b"\r", b"\r\n", b""], ids=["LF", "CR", "CR LF", "CR and LF in turn"])
def test_a_csv_file_of_too_many_numbers_is_refused_before_it_is_parsed(end: bytes, tmp_path: Path) -> None:
    path = tmp_path / "long.csv"
    rows = MOST_NUMBERS // 4 + 2
    two_rows = (b"0,0,0,0" + end) * 2 if end else b"0,0,0,0\r0,0,0,0\n"
    path.write_bytes(b",".join(name.encode() for name in REQUIRED_COLUMNS) + b"\n" + two_rows * (rows // 2))
    peak, refused = peak_of_reading(path)
    assert re.search(rf"holds \d+ rows of 4 columns, limit {MOST_NUMBERS} numbers", refused), refused
    assert 0 < peak < 20_000_000


def test_columns_of_a_csv_file_that_nobody_asked_for_are_not_kept(tmp_path: Path) -> None:
    path = tmp_path / "wide.csv"
    row = ",".join(["0"] * 1000)
    path.write_text(
        ",".join([*REQUIRED_COLUMNS, *(f"c{k}" for k in range(996))]) + f"\n{row}\n{row.replace('0', '1', 1)}"
    )
    np.testing.assert_array_equal(read_columns(path).time, [0, 1])
    path.write_text(path.read_text().replace("effort", "torque"))
    with pytest.raises(BadInput, match=r"'effort' is missing; there are time, torque, .*, c15 and 980 more"):
        read_columns(path)


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="the largest resident memory is read from /proc")
@pytest.mark.parametrize("suffix", [".parquet", ".csv"])
def test_a_long_file_is_in_memory_once_and_a_part_of_it_twice(tmp_path: Path, suffix: str) -> None:
    """Largest resident memory of a process that reads 3,000,000 rows, whose four columns are 92 MiB.

    Some 120 MiB of it do not depend on the file (libraries and the buffers of Arrow).
    """
    path = tmp_path / f"long{suffix}"
    rows = 3_000_000
    values = np.random.default_rng(1).normal(size=rows).round(4)
    write_columns(path, Recording(np.arange(rows) / 1000, values, values, values))
    program = (
        "import sys; from pathlib import Path; from service.store.files.columns import read_columns;"
        "largest = lambda: int(Path('/proc/self/status').read_text().partition('VmHWM:')[2].split()[0]);"
        "before = largest(); print(read_columns(Path(sys.argv[1])).time.size, largest() - before)"
    )
    answer = subprocess.run([sys.executable, "-c", program, str(path)], capture_output=True, text=True, check=True)
    read, grown = map(int, answer.stdout.split())
    assert read == rows
    assert grown < 280 * 1024  # KiB


def test_lines_may_end_in_different_ways(tmp_path: Path) -> None:
    path = tmp_path / "sweep.csv"
    path.write_bytes(b"time,effort,velocity,position\r0,1,2,3\n1,1,2,4\r\n2,1,2,5\r3,1,2,6\r4,1,2,7\n")
    np.testing.assert_array_equal(read_columns(path).position, [3, 4, 5, 6, 7])


def test_a_column_of_whole_numbers_may_go_on_with_fractions(tmp_path: Path) -> None:
    """The file is read in blocks of 1 MiB, and the kind of a column is not that of its first block."""
    path = tmp_path / "sweep.csv"
    rows = 150_000
    effort = [str(k) for k in range(rows - 1)]
    path.write_text(
        "time,effort,velocity,position\n"
        + "".join(f"{k},{value},,0\n" for k, value in enumerate(effort))
        + f"{rows - 1},0.5,1e-3,0\n"
    )
    assert path.stat().st_size > 2**21
    found = read_table(path, "the sweep", ("time", "effort", "velocity"))
    np.testing.assert_array_equal(found["effort"], [*range(rows - 1), 0.5])
    assert np.isnan(found["velocity"][:-1]).all()
    assert found["velocity"][-1] == 1e-3
    path.write_text(path.read_text() + f"{rows},half,0,0\n")
    with pytest.raises(BadInput, match=f"Row #{rows + 2}: CSV conversion error to double: invalid value 'half'"):
        read_columns(path)
