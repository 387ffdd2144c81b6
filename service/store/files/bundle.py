"""The exchange format `sweepid-bundle/1` (docs/reference/bundle.md): a directory of bundle.json, a URDF and one file
per sweep.

Reading validates everything before it returns anything; writing uses a temporary directory next to the target that is
renamed when it is complete, so a bundle is always complete.
"""

import errno
import shutil
import zipfile
import zlib
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal
from uuid import uuid4

import numpy as np
from pydantic import BaseModel, ConfigDict, StringConstraints, ValidationError

from service import BadInput
from service.model import Robot, RobotDescription, Sweep, SweepSpec, robot_from_outside
from service.model.configuration import bad_field, read_text
from service.model.results.part import Column, Shown, Table, columns_of_sweeps
from service.store.documents import NewRecording, RecordingState
from service.store.files.columns import check_possible, check_samples, columns_of, read_columns, write_columns
from service.store.files.recordings import RecordingFiles, check_new, new_folder

if TYPE_CHECKING:
    from matplotlib.axes import Axes

MOST_IN_BUNDLE = 250_000_000  # all sweeps of a bundle are in memory together


@dataclass(frozen=True, slots=True, repr=False)
class Bundle(Shown):
    """A robot and its measured sweeps, in the order of bundle.json; `place` is told in errors."""

    robot: Robot
    sweeps: tuple[Sweep, ...]
    place: str = field(default="bundle", compare=False)

    def table(self) -> Table:
        """One row a sweep."""
        specs = [sweep.spec for sweep in self.sweeps]
        return Table(
            f"Bundle of the robot {self.robot.name}",
            (
                *columns_of_sweeps(specs),
                Column("repeat", tuple(spec.repeat for spec in specs)),
                Column("samples", tuple(len(sweep.recording.time) for sweep in self.sweeps)),
            ),
        )

    def plot(self) -> "Sequence[Axes]":
        """Draws the effort of each sweep, by axis."""
        from service.model.results import plots  # matplotlib

        return plots.efforts(self.sweeps)


class _Entry(SweepSpec):
    file: str


class _BundleDocument(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)
    format: Literal["sweepid-bundle/1"]
    robot: RobotDescription
    sweeps: tuple[_Entry, ...]


def read_bundle(directory: Path) -> Bundle:
    """Read and validate a whole bundle. BadInput names the file, the sweep and the reason of the first error."""
    place = directory / "bundle.json"
    try:
        document = _BundleDocument.model_validate_json(read_text(place), strict=True)
    except ValidationError as error:
        raise bad_field(str(place), error) from None
    description = document.robot
    urdf = _inside(directory, description.urdf, f"{place} robot.urdf")
    robot = robot_from_outside(description, read_text(urdf), f"{place} robot")
    specs = [SweepSpec.model_validate(entry.model_dump(exclude={"file"})) for entry in document.sweeps]
    check_specs(robot, specs, str(place))
    sweeps: list[Sweep] = []
    numbers = 0
    for entry, spec in zip(document.sweeps, specs, strict=True):
        path = _inside(directory, entry.file, f"{place} sweep {spec.id}")
        here = f"{path} sweep {spec.id}"
        sweep = Sweep(spec, read_columns(path, here))
        numbers += sum(column.size for column in columns_of(sweep.recording).values())
        if numbers > MOST_IN_BUNDLE:
            raise BadInput(str(place), f"its sweeps contain more than {MOST_IN_BUNDLE} numbers in total")
        check_possible(sweep.recording, here)
        check_clock(sweep, here)
        sweeps.append(sweep)
    return Bundle(robot, tuple(sweeps), str(directory))


def write_bundle(
    directory: Path, robot: Robot, sweeps: Sequence[Sweep], samples: Literal[".parquet", ".csv"] = ".parquet"
) -> None:
    """Write a bundle to a new or empty directory. BadInput, and nothing is written, if `read_bundle` would refuse."""
    check_new(directory)
    check_specs(robot, [sweep.spec for sweep in sweeps], str(directory))
    for sweep in sweeps:
        check_samples(sweep.recording, f"{directory} sweep {sweep.spec.id}")
        check_possible(sweep.recording, f"{directory} sweep {sweep.spec.id}")
        check_clock(sweep, f"{directory} sweep {sweep.spec.id}")
    with new_folder(directory) as partial:
        _write_into(partial, robot, sweeps, samples)


def check_specs(robot: Robot, specs: Sequence[SweepSpec], place: str) -> None:
    """Check the sweeps of a robot without their samples; BadInput names the sweep."""
    if not specs:
        raise BadInput(place, "has no sweeps")
    seen: set[str] = set()
    for spec in specs:
        here = f"{place} sweep {spec.id}"
        if spec.id in seen:
            raise BadInput(here, "another sweep has the same id")
        seen.add(spec.id)
        if spec.axis not in robot.joints:
            raise BadInput(here, f"unknown joint {spec.axis!r}; robot {robot.name} has {', '.join(robot.joints)}")
        if len(spec.pose) != len(robot.joints):
            raise BadInput(here, f"pose has {len(spec.pose)} numbers, robot {robot.name} has {len(robot.joints)} axes")
        if (spec.period is None) != (spec.periods is None):
            raise BadInput(here, f"period is {spec.period} but periods is {spec.periods}; give both or neither")
        _check_sines(spec, here)
        samples = (spec.period or 0.0) * (spec.periods or 0) * spec.sample_rate
        if spec.periodic and not (samples < 1e9 and abs(samples - round(samples)) <= 1e-6 * samples):
            raise BadInput(
                here, f"{spec.periods} periods of {spec.period} s are not whole samples at {spec.sample_rate} Hz"
            )


def check_clock(sweep: Sweep, place: str) -> None:
    """Raises BadInput unless `time` follows sample_rate without a gap and the measured window is inside the record.

    A sample may deviate from its grid point by half a sample, so that a missing sample is always detected.
    """
    spec, time = sweep.spec, sweep.recording.time
    rate = spec.sample_rate
    with np.errstate(over="ignore", invalid="ignore"):  # extreme rates give inf and NaN, which fail every check
        steps = np.diff(time) * rate
        late = (time - time[0]) * rate - np.arange(time.size)
    gaps = np.flatnonzero(~(steps <= 1.5))
    if gaps.size:
        lost = int(gaps[0])
        raise BadInput(
            place, f"gap in time: {time[lost + 1]:.6g} s follows {time[lost]:.6g} s, sample_rate is {rate:.6g} Hz"
        )
    if not (np.abs(late) <= 0.5).all():
        measured = (time.size - 1) / (time[-1] - time[0])
        raise BadInput(place, f"sample_rate is {rate:.6g} Hz, but time runs at {measured:.6g} Hz")
    length = time.size / rate
    end = spec.measure_from + (spec.period or 0.0) * (spec.periods or 0)
    if not end <= length + 0.5 / rate or spec.measure_from >= length:
        raise BadInput(
            place,
            f"measured window {spec.measure_from:.6g} to {end:.6g} s lies outside of the record of {length:.6g} s",
        )


def _check_sines(spec: SweepSpec, place: str) -> None:
    frequencies = [sine.frequency for sine in spec.sines]
    for frequency in frequencies:
        if frequency >= spec.sample_rate / 2:
            raise BadInput(
                place, f"sine of {frequency:.6g} Hz is not below half the sample rate {spec.sample_rate:.6g} Hz"
            )
        if frequencies.count(frequency) > 1:
            raise BadInput(place, f"two sines of {frequency:.6g} Hz")
        if spec.period is not None:
            turns = frequency * spec.period
            if not turns < 1e9 or round(turns) < 1 or abs(turns - round(turns)) > 1e-6 * turns:
                raise BadInput(
                    place,
                    f"sine of {frequency:.9g} Hz makes {turns:.9g} turns in a period of {spec.period:.9g} s, not whole",
                )


def _inside(directory: Path, name: str, place: str) -> Path:
    """The file named by a bundle. Raises BadInput if it is outside the bundle, with symbolic links resolved."""
    try:
        path = directory / name
        inside = not Path(name).is_absolute() and path.resolve().is_relative_to(directory.resolve())
    except (OSError, ValueError, RuntimeError) as error:  # NUL in the name, loop of links
        raise BadInput(place, f"file name {name!r} is not valid: {error}") from None
    if not inside:
        raise BadInput(place, f"file {name!r} lies outside of the bundle")
    return path


def _write_into(directory: Path, robot: Robot, sweeps: Sequence[Sweep], samples: str) -> None:
    (directory / "sweeps").mkdir()
    (directory / "robot.urdf").write_text(robot.urdf_text, encoding="utf-8")
    entries: list[_Entry] = []
    for number, sweep in enumerate(sweeps, start=1):
        name = f"sweeps/{number:04d}{samples}"  # ids are free text and cannot be file names
        write_columns(directory / name, sweep.recording)
        entries.append(_Entry.model_validate(sweep.spec.model_dump() | {"file": name}))
    description = robot.description.model_copy(update={"urdf": "robot.urdf"})
    document = _BundleDocument(format="sweepid-bundle/1", robot=description, sweeps=tuple(entries))
    (directory / "bundle.json").write_text(document.model_dump_json(indent=2) + "\n", encoding="utf-8")


class SavedBundle(BaseModel):
    """A bundle whose samples are already in files, one recording per sweep; `folder`: the name of their folder."""

    model_config = ConfigDict(frozen=True, extra="forbid")
    robot: RobotDescription
    urdf_text: str
    sweeps: tuple[SweepSpec, ...]
    recordings: tuple[NewRecording, ...]
    folder: Annotated[str, StringConstraints(pattern="^import-[0-9a-f]{32}$")]  # set by the reader


def save_bundle(files: RecordingFiles, bundle: Bundle) -> SavedBundle:
    """Write the recordings of a bundle to a new folder; all of them or nothing."""
    name = f"import-{uuid4().hex}"
    folder = files.folder(name)
    try:
        recordings = tuple(
            files.save(
                folder / f"{number:04d}-1.parquet",
                sweep.recording,
                RecordingState.COMPLETE,
                {"robot": bundle.robot.name, "spec": sweep.spec.model_dump(mode="json")},
            )
            for number, sweep in enumerate(bundle.sweeps, 1)
        )
    except BaseException:
        shutil.rmtree(folder)
        raise
    return SavedBundle(
        robot=bundle.robot.description,
        urdf_text=bundle.robot.urdf_text,
        sweeps=tuple(sweep.spec for sweep in bundle.sweeps),
        recordings=recordings,
        folder=name,
    )


def take_in(source: Path, work: Path) -> dict[str, Any]:
    """`save_bundle` of a bundle (its folder or a zip of it) below `work`, an empty folder, as JSON."""
    return save_bundle(RecordingFiles(work), read_from(source, work / "bundle")).model_dump(mode="json")


def pack(folder: Path, archive: Path) -> Path:
    """Write the folder of a bundle as a zip, whose path is returned."""
    with zipfile.ZipFile(archive, "w", zipfile.ZIP_STORED) as content:  # Parquet is already compressed
        for path in sorted(folder.rglob("*")):
            content.write(path, path.relative_to(folder))
    return archive


def read_from(source: Path, folder: Path) -> Bundle:
    """The bundle in a folder or a zip, which is unpacked into `folder`; BadInput then names places in the bundle."""
    if source.is_dir():
        return read_bundle(source)
    _unpack(source, folder)
    inner = [folder, *(path.parent for path in folder.glob("*/bundle.json"))]  # of a folder that was zipped as a whole
    try:
        return read_bundle(inner[1] if len(inner) == 2 and not (folder / "bundle.json").exists() else folder)
    except BadInput as error:  # the sender knows the bundle, not this folder
        raise BadInput(_own_place(error.place, folder), _own_place(error.reason, folder)) from None


def _unpack(archive: Path, folder: Path, most_bytes: int = 4 * 2**30, most_files: int = 20_000) -> None:
    """A small zip can contain very large files. `zipfile` itself removes path components that would leave it."""
    try:
        with zipfile.ZipFile(archive) as content:
            members = content.infolist()
            if len(members) > most_files:
                raise BadInput("bundle", f"has {len(members)} files, limit {most_files}")
            for member in members:
                member.filename = member.filename.replace("\\", "/")  # of a program of Windows
                # LZMA allocates the dictionary size stated by the member, up to 4 GiB, before it reads a byte
                if member.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED, zipfile.ZIP_BZIP2):
                    raise BadInput(
                        f"bundle {member.filename[:60]!r}",
                        f"is compressed by method {member.compress_type} of zip, which is not read; compress it by "
                        "deflate (8) or bzip2 (12), or store it (0)",
                    )
            size = sum(member.file_size for member in members)
            if size > most_bytes:
                raise BadInput("bundle", f"unpacks to {size} bytes, limit {most_bytes} bytes")
            content.extractall(folder, members)
    except (zipfile.BadZipFile, zlib.error, EOFError, NotImplementedError, RuntimeError) as error:
        raise BadInput("bundle", f"cannot be unpacked: {error}") from None
    except OSError as error:
        # a name that is too long, a file that is also a folder, an offset before the archive; None: bad bzip2 data.
        # Other codes, such as a full disk, are errors of this computer
        if error.errno not in (errno.ENAMETOOLONG, errno.ENOTDIR, errno.EISDIR, errno.EEXIST, errno.EINVAL, None):
            raise
        raise BadInput("bundle", f"cannot be unpacked: {error.strerror or error}") from None


def _own_place(text: str, folder: Path) -> str:
    return text.replace(f"{folder}/", "").replace(str(folder), "bundle")
