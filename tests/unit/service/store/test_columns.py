"""Samples as Parquet and CSV: what is written comes back to the last bit, what is no sample is refused by name."""

from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from service.errors import BadInput
from service.recording import OPTIONAL_COLUMNS, REQUIRED_COLUMNS, Recording
from service.store.files.columns import LARGEST_CSV, MOST_NUMBERS, read_columns, write_columns

PLAIN = "time,effort,velocity,position\n0,1,2,3\n0.5,1,2,3\n"


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


def test_columns_of_others_are_left_out(tmp_path: Path) -> None:
    path = tmp_path / "sweep.csv"
    path.write_text("remark,time,effort,velocity,position\nwarm,0,1,2,3\nstill warm,0.5,1,2,3\n")
    np.testing.assert_array_equal(read_columns(path).position, [3, 3])


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


def test_an_optional_column_with_a_hole_is_refused(tmp_path: Path) -> None:
    columns = {name: [0.0, 1.0] for name in REQUIRED_COLUMNS} | {"load_position": [None, 1.0]}
    pq.write_table(pa.table(columns), tmp_path / "sweep.parquet")
    with pytest.raises(BadInput, match="'load_position' is nan in row 1"):
        read_columns(tmp_path / "sweep.parquet")


def test_a_torn_parquet_file_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "sweep.parquet"
    write_columns(path, Recording(*(np.arange(1000.0) for _ in range(4))))
    path.write_bytes(path.read_bytes()[:-100])
    with pytest.raises(BadInput, match="cannot be read"):
        read_columns(path)


@pytest.mark.parametrize("name", ["sweep.txt", "missing.csv", "missing.parquet", "."])
def test_files_that_are_not_there(tmp_path: Path, name: str) -> None:
    with pytest.raises(BadInput):
        read_columns(tmp_path / name)


def test_nothing_unreadable_is_written(tmp_path: Path) -> None:
    good = np.arange(3.0)
    for bad in (Recording(good, good, good, good[:2]), Recording(good, good, np.array([0, np.nan, 1]), good)):
        with pytest.raises(BadInput):
            write_columns(tmp_path / "sweep.parquet", bad)
    with pytest.raises(BadInput, match="parquet or"):
        write_columns(tmp_path / "sweep.txt", Recording(good, good, good, good))
    assert list(tmp_path.iterdir()) == []


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


def test_columns_that_nobody_asked_for_are_not_read(tmp_path: Path) -> None:
    path = tmp_path / "wide.parquet"
    time = np.arange(1000) / 1000
    table = pa.table(dict.fromkeys(REQUIRED_COLUMNS, time) | {"note": ["x" * 100_000] * 1000})
    pq.write_table(table, path)
    del table
    pa.default_memory_pool().release_unused()
    peak = pa.default_memory_pool().max_memory()
    read_columns(path)
    assert pa.default_memory_pool().max_memory() - peak < 10_000_000


def test_a_csv_file_that_is_too_large_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "large.csv"
    with path.open("wb") as file:
        file.truncate(LARGEST_CSV + 1)
    with pytest.raises(BadInput, match=f"limit {LARGEST_CSV} bytes"):
        read_columns(path)
