"""Recordings in the files of other tools, read back by clients that are not ours, and by our own import."""

import csv
import json
from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, cast

import asammdf
import h5py
import mf4_rs
import numpy as np
import pandas as pd
import pyfive
import pytest
from mcap.reader import make_reader

from service.formats.export.recordings import write_recordings
from service.model import Sweep
from service.store.files.bundle import read_bundle, write_bundle
from service.store.files.columns import columns_of
from tests.command import sweepid
from tests.recorded_bundle import bundle, mapping

BEGAN = datetime(2026, 11, 24, 8, 0, tzinfo=UTC)
# what has no types
_h5, _pyfive, _mf4 = cast(Any, h5py), cast(Any, pyfive), cast(Any, mf4_rs)


def assert_same(one: Sweep, other: Sweep) -> None:
    assert one.spec == other.spec
    ours, theirs = columns_of(one.recording), columns_of(other.recording)
    assert list(ours) == list(theirs)
    for name, column in ours.items():
        np.testing.assert_array_equal(column, theirs[name], strict=True)


def assert_columns(sweep: Sweep, of: Callable[[str], Any]) -> None:
    for name, column in columns_of(sweep.recording).items():
        np.testing.assert_array_equal(of(name), column)


@pytest.mark.slow
@pytest.mark.parametrize("suffix", [".mf4", ".h5"])
def test_what_goes_out_comes_back_bit_by_bit(tmp_path: Path, suffix: str) -> None:
    """The contract: bundle, file, import, bundle; through the commands, the reader in a process of its own."""
    first = bundle()
    write_bundle(tmp_path / "first", first.robot, first.sweeps)
    done = sweepid("export", "recording", str(tmp_path / "first"), str(tmp_path / f"out{suffix}"))
    assert (done.returncode, done.stdout) == (0, "")
    ids = [sweep.spec.id for sweep in first.sweeps]
    groups = dict(zip(ids, ids if suffix == ".mf4" else ("sweeps/0001", "sweeps/0002"), strict=True))
    file = mapping(tmp_path / "mapping.yaml", f"out{suffix}", groups)
    done = sweepid("import", "trace", str(file), "--out", str(tmp_path / "second"))
    assert done.returncode == 0, done.stderr
    second = read_bundle(tmp_path / "second")
    assert (second.robot.axes, second.robot.urdf_text) == (first.robot.axes, first.robot.urdf_text)
    for one, other in zip(first.sweeps, second.sweeps, strict=True):
        assert_same(one, other)


def test_csv_comes_back_bit_by_bit(tmp_path: Path) -> None:
    first = bundle()
    write_recordings(tmp_path / "tables", first)
    for one, other in zip(first.sweeps, read_bundle(tmp_path / "tables").sweeps, strict=True):
        assert_same(one, other)
    write_recordings(tmp_path / "one.csv", first, [first.sweeps[1].spec.id])
    with (tmp_path / "one.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert_columns(first.sweeps[1], lambda name: [float(row[name]) for row in rows])


def test_mdf4_tells_units_sources_and_times_to_two_libraries(tmp_path: Path) -> None:
    given = bundle()
    write_recordings(tmp_path / "out.mf4", given, began=BEGAN)
    with asammdf.MDF(tmp_path / "out.mf4") as file:
        assert file.header.start_time == BEGAN
        assert file.version == "4.10"
        for number, sweep in enumerate(given.sweeps):
            group = cast(Any, file.groups[number]).channel_group
            assert (group.acq_name, group.acq_source.name) == (sweep.spec.id, sweep.spec.axis)
            assert json.loads(group.comment) == sweep.spec.model_dump(mode="json")
            effort = file.get("effort", group=number)
            assert (effort.unit, cast(Any, effort.source).name) == ("N m", sweep.spec.axis)
            np.testing.assert_array_equal(effort.samples, sweep.recording.effort)
            np.testing.assert_array_equal(effort.timestamps, sweep.spec.started_at + sweep.recording.time)
        attached = {one.file_name: file.extract_attachment(k)[0] for k, one in enumerate(cast(Any, file).attachments)}
    assert attached["robot.urdf"] == given.robot.urdf_text.encode()
    assert json.loads(attached["recordings.json"])["robot"]["name"] == given.robot.name
    file = _mf4.Mdf(str(tmp_path / "out.mf4"))
    assert [group.name for group in file.groups] == [sweep.spec.id for sweep in given.sweeps]
    for sweep, group in zip(given.sweeps, file.groups, strict=True):
        told = ("campaign_time", "s"), ("time", "s"), ("effort", "N m"), ("velocity", "rad/s")
        assert tuple((one.name, one.unit) for one in group.channels)[:4] == told
        assert_columns(sweep, lambda name, sweep=sweep: np.asarray(file.values(name, sweep.spec.id)))


def test_hdf5_has_a_group_a_sweep_for_two_libraries(tmp_path: Path) -> None:
    given = bundle()
    write_recordings(tmp_path / "out.h5", given, began=BEGAN)
    with _h5.File(tmp_path / "out.h5") as file:
        assert file.attrs["began"] == "2026-11-24T08:00:00+00:00"
        assert file["robot.urdf"][()].decode() == given.robot.urdf_text
        told = json.loads(file["recordings.json"][()])
        assert [sweep["id"] for sweep in told["sweeps"]] == [sweep.spec.id for sweep in given.sweeps]
        for sweep, group in zip(given.sweeps, file["sweeps"].values(), strict=True):
            assert (group.attrs["id"], group.attrs["axis"]) == (sweep.spec.id, sweep.spec.axis)
            table = pd.DataFrame({name: dataset[()] for name, dataset in group.items()})
            assert group["velocity"].attrs["units"] == "rad/s"
            assert group["velocity"].dims[0][0] == group["time"]
            assert_columns(sweep, table.__getitem__)
    with _pyfive.File(str(tmp_path / "out.h5")) as file:
        for number, sweep in enumerate(given.sweeps, start=1):
            group = file[f"sweeps/{number:04d}"]
            assert group.attrs["sample_rate"] == sweep.spec.sample_rate
            assert_columns(sweep, lambda name, group=group: group[name][:])


def test_mcap_has_a_topic_a_joint(tmp_path: Path) -> None:
    given = bundle()
    write_recordings(tmp_path / "out.mcap", given, began=BEGAN)
    with (tmp_path / "out.mcap").open("rb") as stream:
        reader = make_reader(stream)
        messages = [(channel.topic, schema, message) for schema, channel, message in reader.iter_messages()]
        attached = {one.name: one.data for one in reader.iter_attachments()}
        told = {one.name: one.metadata for one in reader.iter_metadata()}
    assert attached["robot.urdf"] == given.robot.urdf_text.encode()
    assert [message.log_time for *_, message in messages] == sorted(message.log_time for *_, message in messages)
    for sweep in given.sweeps:
        own = [(schema, message) for topic, schema, message in messages if topic == f"/{sweep.spec.axis}"]
        assert told[f"sweep {sweep.spec.id}"]["sample_rate"] == str(sweep.spec.sample_rate)
        samples = [json.loads(message.data) for _, message in own]
        assert {sample["sweep"] for sample in samples} == {sweep.spec.id}
        assert_columns(sweep, lambda name, samples=samples: [sample[name] for sample in samples])
        schema, first = own[0]
        assert first.log_time == round((BEGAN.timestamp() + sweep.spec.started_at) * 1e9)
        assert schema is not None
        properties = json.loads(schema.data)["properties"]
        assert set(samples[0]) <= set(properties)
        assert properties["effort"]["description"].startswith("N m: ")


@pytest.mark.parametrize(
    ("arguments", "reason"),
    [
        (("out.csv",), "out.csv: can contain one sweep: choose it with --sweep (joint_2 no. 1, joint_3 no. 2)"),
        (("out.xls",), "out.xls: recordings are written as .mf4, .h5, .hdf5, .mcap, .csv"),
        (("there.mf4",), "there.mf4: exists already"),
        (("bundle/robot.urdf/out.mcap",), "cannot be written: "),
        (("out.mcap", "--sweep", "x"), "--sweep: sweep 'x' does not exist; there are joint_2 no. 1, joint_3 no. 2"),
        (("out.mcap", "--began", "2026-11-24T08:00:00"), "--began: '2026-11-24T08:00:00' has no zone"),
        (("out.mcap", "--began", "9999-01-01T00:00:00Z"), "started_at: 12.3 s is outside"),
        (("out.mcap", "--began", "soon"), "--began: 'soon' is not a time"),
    ],
)
def test_refusals_leave_nothing(tmp_path: Path, arguments: tuple[str, ...], reason: str) -> None:
    given = bundle()
    write_bundle(tmp_path / "bundle", given.robot, given.sweeps)
    (tmp_path / "there.mf4").write_text("x")
    before = sorted(tmp_path.rglob("*"))
    out, *options = arguments
    done = sweepid("export", "recording", str(tmp_path / "bundle"), str(tmp_path / out), *options)
    assert (done.returncode, done.stdout) == (2, "")
    assert reason in done.stderr
    assert sorted(tmp_path.rglob("*")) == before
