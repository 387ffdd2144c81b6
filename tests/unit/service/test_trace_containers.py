"""Traces in MATLAB, MDF4 and HDF5 files of other programs: what is read, what is converted, what is refused."""

import io
import sys
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, cast

import asammdf
import h5py
import mf4_rs
import numpy as np
import pytest
from asammdf.blocks.v4_blocks import ChannelConversion
from scipy.io import savemat

from service import BadInput
from service.formats.export.recordings import write_recordings
from service.formats.traces.containers import ChannelName, Taken, read_containers, read_here
from service.formats.traces.trace_import import import_trace
from service.store.files.columns import MOST_NUMBERS
from service.store.files.isolated_reader import Limits
from tests.command import sweepid
from tests.forked import forked
from tests.recorded_bundle import bundle
from tests.unit.service.test_trace_import import SWEEP, mapping, trace, write_csv

pytestmark = pytest.mark.slow

_h5, _mf4 = cast(Any, h5py), cast(Any, mf4_rs)  # without types
TIME = np.arange(500) / 250
NAMED = {name: {"source": name} for name in ("effort", "velocity", "position")}


def ask(path: Path, *sources: str, group: str | int | None = None) -> Taken:
    """The channels of one sweep, read in this process."""
    (taken,) = read_here(path, [[ChannelName(source=source, group=group) for source in sources]])
    return taken


def refusal(path: Path, *sources: str, group: str | int | None = None) -> str:
    with pytest.raises(BadInput) as refused:
        ask(path, *sources, group=group)
    return str(refused.value)


def write_mdf4(path: Path, *groups: Sequence[asammdf.Signal]) -> Path:
    with asammdf.MDF(version="4.10") as file:
        for number, signals in enumerate(groups):
            file.append(list(signals), acq_name=f"group {number}", common_timebase=True)
        file.save(path)
    return path


def signal(name: str, unit: str = "", times: np.ndarray = TIME, **more: Any) -> asammdf.Signal:
    return asammdf.Signal(samples=np.arange(len(times), dtype=float), timestamps=times, name=name, unit=unit, **more)


def write_hdf5(path: Path, **datasets: tuple[object, str]) -> Path:
    with _h5.File(str(path), "w") as file:
        for name, (values, unit) in datasets.items():
            file[f"run/{name}"] = values
            if unit:
                file[f"run/{name}"].attrs["units"] = unit
    return path


def test_a_file_that_another_library_wrote(tmp_path: Path) -> None:
    """Its clock is that of the bundle, without a word of it in the mapping."""
    path = tmp_path / "logger.mf4"
    file = _mf4.MdfWriter(str(path))
    file.init_mdf_file()
    group = file.add_channel_group("drive")
    file.add_time_channel(group, "t")
    for name in NAMED:
        file.add_float_channel(group, name)
    columns = [TIME + 7.0, *(np.cos(k + TIME) for k in range(3))]
    file.start_data_block(group)
    file.write_columns_f64(group, columns)
    file.finish_data_block(group)
    file.finalize()
    _, (sweep,) = import_trace(mapping(tmp_path, "logger.mf4", columns=NAMED))
    np.testing.assert_allclose(sweep.recording.time, TIME, atol=1e-12)
    np.testing.assert_array_equal(sweep.recording.velocity, columns[2])


@pytest.mark.parametrize("suffix", [".mf4", ".h5"])
def test_units_of_the_file_are_converted(tmp_path: Path, suffix: str) -> None:
    units = {"effort": "kN·m", "velocity": "°/s", "position": "deg"}
    if suffix == ".mf4":
        write_mdf4(tmp_path / "a.mf4", [signal(name, unit) for name, unit in units.items()])
    else:
        write_hdf5(tmp_path / "a.h5", **{name: (np.arange(500.0), unit) for name, unit in units.items()})
    _, (sweep,) = import_trace(mapped(tmp_path, f"a{suffix}", "group 0" if suffix == ".mf4" else "run"))
    assert sweep.recording.effort[1] == pytest.approx(1000.0)
    assert sweep.recording.velocity[180] == pytest.approx(np.pi)
    assert sweep.recording.position[180] == pytest.approx(np.pi)
    assert sweep.recording.time[-1] == pytest.approx(499 / 250)


def mapped(folder: Path, name: str, group: str, **columns: dict[str, object]) -> Path:
    """A mapping of the channels of one group of a file, in SI but for those of `columns`."""
    sweep = SWEEP | {"source": name, "id": "1", "sample_rate": 250, "group": group}
    return mapping(folder, name, columns={**NAMED, **columns}, sweeps=[sweep])


@pytest.mark.parametrize(
    ("unit", "column", "reason"),
    [
        ("rpm", {"source": "velocity"}, "unit 'rpm' of the file is not a unit of velocity that follows position"),
        ("mm/s", {"source": "velocity"}, "unit 'mm/s' of the file is not a unit of velocity"),
        ("rad/s", {"source": "velocity", "unit": "motor rev/min"}, "says 'motor rev/min', the file says 'rad/s'"),
    ],
)
def test_a_unit_that_does_not_fit_is_refused(tmp_path: Path, unit: str, column: dict[str, object], reason: str) -> None:
    values = np.arange(500.0)
    write_hdf5(tmp_path / "a.h5", effort=(values, "Nm"), velocity=(values, unit), position=(values, "rad"))
    with pytest.raises(BadInput, match=f"sweep 1 column velocity: .*{reason}"):
        import_trace(mapped(tmp_path, "a.h5", "run", velocity=column))


def test_the_mapping_may_overrule_a_unit(tmp_path: Path) -> None:
    values = np.arange(500.0)
    write_hdf5(tmp_path / "a.h5", effort=(values, "A"), velocity=(values, "rpm"), position=(values, ""))
    effort: dict[str, object] = {"source": "effort", "scale": 2.0}
    velocity: dict[str, object] = {"source": "velocity", "unit": "motor rev/min"}
    _, (sweep,) = import_trace(mapped(tmp_path, "a.h5", "run", effort=effort, velocity=velocity))
    assert (sweep.recording.effort[3], sweep.recording.position[3]) == (6.0, 3.0)
    assert sweep.recording.velocity[60] == pytest.approx(2 * np.pi)


def test_linear_conversions_and_marks_of_what_is_invalid_are_applied_and_formulas_refused(tmp_path: Path) -> None:
    counts = signal("counts", "Nm", conversion={"a": 0.5, "b": 3.0})
    formula = signal("formula", conversion=ChannelConversion(conversion_type=3, formula="X1 * 2"))
    path = write_mdf4(tmp_path / "a.mf4", [counts, formula, signal("effort", invalidation_bits=np.arange(500) == 7)])
    np.testing.assert_array_equal(ask(path, "counts").columns[0], 0.5 * np.arange(500) + 3)
    assert np.flatnonzero(np.isnan(ask(path, "effort").columns[0])).tolist() == [7]
    assert "channel formula: has the conversion ALG; only none and linear" in refusal(path, "formula")


def test_groups_of_one_clock_are_one_sweep_and_others_are_refused(tmp_path: Path) -> None:
    path = write_mdf4(
        tmp_path / "a.mf4",
        [signal("effort"), signal("both")],
        [signal("position")],
        [signal("velocity", times=0.004 + np.arange(200) / 100), signal("both")],
    )
    np.testing.assert_array_equal(cast(np.ndarray, ask(path, "effort", "position").clock), TIME)
    told = refusal(path, "effort", "velocity")
    assert "groups with different clocks, nothing is resampled" in told
    assert "0 'group 0' has 500 samples from 0 s on at 250 Hz; 2 'group 2' has 200 samples from 0.004 s on" in told
    assert "channel both: occurs 2 times, in groups 0 'group 0', 2 'group 2': give one" in refusal(path, "both")
    assert len(ask(path, "both", group=2).columns[0]) == 200
    assert "group 'x' does not exist; there are 0 'group 0', 1" in refusal(path, "both", group="x")
    assert "channel none: does not exist; there are time, effort, both" in refusal(path, "none", group=0)


def test_hdf5_that_leads_elsewhere_is_not_followed(tmp_path: Path) -> None:
    path = write_hdf5(tmp_path / "a.h5", short=(np.zeros(3), ""), text=("x", ""), long=(np.zeros(4), ""))
    (tmp_path / "secret").write_bytes(bytes(800))
    with _h5.File(str(path), "a") as file:
        file["outer"] = _h5.ExternalLink("other.h5", "/x")
        file["soft"] = _h5.SoftLink("/run/short")
        file.create_dataset("raw", (100,), "f8", external=[(str(tmp_path / "secret"), 0, 800)])
        layout = _h5.VirtualLayout((3,), "f8")
        layout[:] = _h5.VirtualSource("other.h5", "x", (3,))
        file.create_virtual_dataset("virtual", layout)
        file.create_dataset("vast", (10**12,), "f8", chunks=(1000,))
    for sources, told in (
        (["outer"], "dataset outer: 'outer' is a link to /x"),
        (["soft"], "dataset soft: 'soft' is a link to /run/short; give the name"),
        (["raw"], "has its values in other files"),
        (["virtual"], "has its values in other files"),
        (["vast"], "holds 1000000000000 values of 1 channels, limit 50000000 numbers"),
        (["run/text"], "is not a column of numbers: object ()"),
        (["run/short", "run/long"], "differ in length, nothing is resampled: run/short has 3, run/long has 4"),
        (["run/none"], "dataset run/none: 'none' does not exist; there are long, short, text"),
        (["run"], "dataset run: is a group"),
    ):
        assert told in refusal(path, *sources)


@pytest.mark.parametrize("suffix", [".mf4", ".h5"])
def test_a_torn_file_is_one_refusal(tmp_path: Path, suffix: str) -> None:
    """At every length that is not all of it."""
    given = bundle()
    write_recordings(tmp_path / f"whole{suffix}", given)
    content = (tmp_path / f"whole{suffix}").read_bytes()
    group = given.sweeps[1].spec.id if suffix == ".mf4" else "sweeps/0002"
    torn = tmp_path / f"torn{suffix}"

    def read_parts() -> None:
        for part in (0, 1, 30, 63, 64, 100, *range(500, len(content) - 1, len(content) // 25), len(content) - 1):
            torn.write_bytes(content[:part])
            with suppress(BadInput):  # else what is missing is not what was asked for
                taken = ask(torn, "effort", group=group)
                np.testing.assert_array_equal(taken.columns[0], given.sweeps[1].recording.effort)

    forked(read_parts)
    torn.write_bytes(content[: len(content) // 2])
    assert refusal(torn, "effort", group=group).startswith(str(torn))


def test_a_file_of_a_name_alone(tmp_path: Path) -> None:
    for suffix in (".mf4", ".h5"):  # the content tells the format
        (tmp_path / f"a{suffix}").write_bytes(b"UnFinMF 4.10    ".ljust(100))
        told = "is not a finalised MDF file: it begins with b'UnFinMF '"
        assert told in refusal(tmp_path / f"a{suffix}", "effort")
        assert "file does not exist" in refusal(tmp_path / f"b{suffix}", "effort")
    (tmp_path / "old.mf4").write_bytes(b"MDF     2.14    ".ljust(28) + (214).to_bytes(2, "little").ljust(40, b"\0"))
    assert "is an MDF file of version 2.14; versions 3 and 4 are read" in refusal(tmp_path / "old.mf4", "effort")


def written() -> bytes:
    content = io.BytesIO()
    savemat(content, trace())  # pyright: ignore[reportArgumentType]  a file object is taken, by its documentation
    return content.getvalue()


def changed(offset: int, value: int) -> bytes:
    """With another word so many bytes behind the name TORQUE, where its columns, type of data and bytes stand."""
    content = bytearray(written())
    at = content.index(b"TORQUE") + offset
    content[at : at + 4] = value.to_bytes(4, "little")
    return bytes(content)


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        (changed(8, 14), "the process that read it was ended by SIG"),
        (changed(12, 2**31 - 1), "cannot be read by SciPy"),
        (changed(-12, 2**31 - 1), "limit 50000000 numbers"),
        (changed(-16, 2**31 - 1), "limit 50000000 numbers"),
        (written()[:121], "cannot be read by SciPy: index out of range"),
        (b"PK\x03\x04", "cannot be read by SciPy: Mat file appears to be truncated"),
        (b"", "cannot be read by SciPy: Mat file appears to be truncated"),
        (b"MATLAB 7.3 MAT-file".ljust(124) + b"\x00\x02IM", "read by h5py: Unable to synchronously open file"),
    ],
)
def test_a_file_made_to_break_its_reader_is_one_error(content: bytes, reason: str, tmp_path: Path) -> None:
    (tmp_path / "trace.mat").write_bytes(content)
    with pytest.raises(BadInput, match=rf"trace\.mat.*{reason}"):
        import_trace(mapping(tmp_path, "trace.mat"))


def test_a_compressed_file_that_unfolds_meets_the_limit_of_memory(tmp_path: Path) -> None:
    """1 MB of zeros stands for 400 MB."""
    path = tmp_path / "trace.mat"
    savemat(path, {"TORQUE": np.zeros(MOST_NUMBERS)}, do_compression=True)
    assert path.stat().st_size < 2_000_000
    asked = [(ChannelName(source="TORQUE", group=None),)]
    with pytest.raises(BadInput, match="needs more memory than the limit of 629145600 bytes"):
        read_containers(path, asked, Limits(memory=600 * 2**20))


def test_the_reader_has_its_limits(tmp_path: Path) -> None:
    path = write_hdf5(tmp_path / "a.h5", effort=(np.zeros(3), ""))
    channels = [(ChannelName(source="effort", group="run"),)]
    with pytest.raises(BadInput, match=r"a.h5: was not read within the limit of 0.01 s"):
        read_containers(path, channels, Limits(time=0.01))
    (taken,) = read_containers(path, channels)
    assert (taken.columns.tolist(), taken.clock) == ([[0.0] * 3], None)


@pytest.mark.parametrize(("suffix", "library", "extra"), [(".h5", "h5py", "hdf5"), (".mf4", "asammdf", "mdf4")])
def test_without_its_library_the_extra_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, suffix: str, library: str, extra: str
) -> None:
    (tmp_path / f"a{suffix}").write_bytes(b"")
    for name in list(sys.modules):
        if name.startswith(f"{library}.") or name == f"service.formats.traces.{extra}":
            monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, library, None)
    wanted = rf"needs {library}[.\w]*: install sweepid with its extra, `sweepid\[{extra}\]`"
    with pytest.raises(BadInput, match=wanted):
        ask(tmp_path / f"a{suffix}", "effort")
    with pytest.raises(BadInput, match=wanted):
        write_recordings(tmp_path / f"out{suffix}", bundle())


def test_other_traces_have_no_groups(tmp_path: Path) -> None:
    write_csv(tmp_path / "a.csv", trace())
    told = r"a.csv: has no groups, but the mapping names 'x': only MDF4, HDF5, ROS bags and"
    with pytest.raises(BadInput, match=told):
        import_trace(mapped(tmp_path, "a.csv", "x"))


def test_the_command_tells_one_line(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    """Nothing of the reader's process beside it."""
    whole = write_mdf4(tmp_path / "a.mf4", [signal(name) for name in NAMED])
    whole.write_bytes(whole.read_bytes()[:2000])
    done = sweepid("import", "trace", str(mapping(tmp_path, "a.mf4", columns=NAMED)), "--out", str(tmp_path / "bundle"))
    assert (done.returncode, done.stdout, capfd.readouterr()) == (2, "", ("", ""))
    (line,) = done.stderr.splitlines()
    assert "a.mf4: cannot be read by asammdf: " in line
    assert not (tmp_path / "bundle").exists()
