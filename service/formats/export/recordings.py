"""Recordings of a bundle in the formats of other tools: MDF4, HDF5, MCAP and CSV. The suffix determines the format.

Each file contains what the sweeps are as JSON, and the robot's URDF. The libraries are optional: each is imported where
its format is written.
"""

import json
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from importlib.metadata import version
from pathlib import Path
from typing import Any, Literal
from uuid import uuid4

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict

from service import BadInput, writing
from service.model import OPTIONAL_COLUMNS, REQUIRED_COLUMNS, Robot, RobotDescription, Sweep, SweepSpec
from service.store.files.bundle import Bundle, write_bundle
from service.store.files.columns import columns_of, write_columns

_DOCUMENT, _URDF = "recordings.json", "robot.urdf"
_UNKNOWN = datetime.fromtimestamp(0, UTC)  # start of the campaign: a bundle does not contain it

_COLUMNS: Mapping[str, tuple[str, str, str]] = {
    "time": ("s", "s", "the drive's own clock, from the beginning of the sweep on"),
    "effort": ("N m", "N", "drive torque (force) from the torque-forming current, on the joint side"),
    "velocity": ("rad/s", "m/s", "motor encoder, on the joint side"),
    "position": ("rad", "m", "motor encoder, on the joint side"),
    "velocity_setpoint": ("rad/s", "m/s", "commanded, on the joint side"),
    "excitation_effort": ("N m", "N", "injected torque (force), on the joint side"),
    "load_velocity": ("rad/s", "m/s", "direct encoder on the joint"),
    "load_position": ("rad", "m", "direct encoder on the joint"),
    "temperature": ("degC", "degC", "of the drive train"),
}
"""Unit of a revolute and of a prismatic joint, in a notation that UDUNITS and Pint also read, and meaning."""


@dataclass(frozen=True, slots=True)
class _Recordings:
    """The data to write: sweeps of a robot, and the start of their campaign (`started_at` is relative to it)."""

    robot: Robot
    sweeps: Sequence[Sweep]
    began: datetime

    def slides(self, joint: str) -> bool:
        return self.robot.chain.joints[self.robot.index(joint)].kind == "prismatic"

    def attachments(self) -> tuple[tuple[str, str, str], ...]:
        """Name, text and media type of what every file contains besides samples."""
        description = self.robot.description.model_copy(update={"urdf": _URDF})
        specs = tuple(sweep.spec for sweep in self.sweeps)
        told = _SweepsDocument(format="sweepid-recordings/1", robot=description, sweeps=specs)
        return (
            (_DOCUMENT, told.model_dump_json(indent=1), "application/json"),
            (_URDF, self.robot.urdf_text, "application/xml"),
        )


class _SweepsDocument(BaseModel):
    """Robot and sweeps in the format of bundle.json, without samples."""

    model_config = ConfigDict(frozen=True)
    format: Literal["sweepid-recordings/1"]
    robot: RobotDescription
    sweeps: tuple[SweepSpec, ...]


def write_recordings(
    out: Path, bundle: Bundle, ids: Collection[str] = (), began: datetime | None = None
) -> tuple[str, ...]:
    """Write all sweeps, or those of these ids, to `out`, which must not exist; returns the written ids.

    `.csv` contains one sweep. A name without suffix becomes a bundle with samples in CSV. BadInput: nothing is written.
    """
    there = [sweep.spec.id for sweep in bundle.sweeps]
    for wanted in ids:
        if wanted not in there:
            raise BadInput("--sweep", f"sweep {wanted!r} does not exist; there are {', '.join(there)}")
    sweeps = [sweep for sweep in bundle.sweeps if not ids or sweep.spec.id in ids]
    with writing(out):
        if out.suffix == "":
            write_bundle(out, bundle.robot, sweeps, ".csv")
        else:
            _write_file(out, _Recordings(bundle.robot, sweeps, began or _UNKNOWN))
    return tuple(sweep.spec.id for sweep in sweeps)


def _write_file(out: Path, recordings: _Recordings) -> None:
    """All or nothing."""
    writers = {
        ".mf4": ("mdf4", _write_mdf4),
        ".h5": ("hdf5", _write_hdf5),
        ".hdf5": ("hdf5", _write_hdf5),
        ".mcap": ("mcap", _write_mcap),
        ".csv": ("", _write_csv),
    }
    suffix = out.suffix.lower()
    if suffix not in writers:
        told = f"recordings are written as {', '.join(writers)}, or without suffix as a folder of CSV"
        raise BadInput(str(out), told)
    if out.exists():
        raise BadInput(str(out), "exists already")
    if suffix == ".csv" and len(recordings.sweeps) != 1:
        ids = ", ".join(sweep.spec.id for sweep in recordings.sweeps)
        told = f"choose it with --sweep ({ids}), or give a name without suffix for all sweeps"
        raise BadInput(str(out), f"can contain one sweep: {told}")
    extra, write = writers[suffix]
    partial = out.with_name(f".{out.stem[:100]}.{uuid4().hex}.partial{suffix}")
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
        write(partial, recordings)
        partial.rename(out)
    except ModuleNotFoundError as error:
        raise BadInput(str(out), f"needs {error.name}: install sweepid with its extra, `sweepid[{extra}]`") from None
    finally:
        partial.unlink(missing_ok=True)


def _write_csv(path: Path, recordings: _Recordings) -> None:
    write_columns(path, recordings.sweeps[0].recording)


def _write_hdf5(path: Path, recordings: _Recordings) -> None:
    """One group per sweep, one dataset per column, `time` as dimension scale."""
    import h5py

    h5: Any = h5py  # has no types
    with h5.File(str(path), "w") as file:
        file.attrs["format"] = "sweepid-recordings/1"
        file.attrs["robot"] = recordings.robot.name
        if recordings.began != _UNKNOWN:
            file.attrs["began"] = recordings.began.isoformat()
        for name, text, _ in recordings.attachments():
            file[name] = text
        for number, sweep in enumerate(recordings.sweeps, start=1):
            # ids are free text, and a slash in a name would create a group
            _write_group(file.create_group(f"sweeps/{number:04d}"), sweep, recordings.slides(sweep.spec.axis))


def _write_group(group: Any, sweep: Sweep, prismatic: bool) -> None:
    for name in SweepSpec.model_fields:
        value = getattr(sweep.spec, name)
        if name != "sines" and value not in (None, ""):
            group.attrs[name] = value
    for name, column in columns_of(sweep.recording).items():
        dataset = group.create_dataset(name, data=column)
        dataset.attrs["units"] = _COLUMNS[name][prismatic]
        dataset.attrs["long_name"] = _COLUMNS[name][2]
        if name == "time":
            dataset.make_scale("time")
        else:
            dataset.dims[0].attach_scale(group["time"])


def _write_mdf4(path: Path, recordings: _Recordings) -> None:
    """MDF 4.10: one channel group per sweep, named by its id; the joint is the source.

    The group's master starts at the beginning of the campaign, so a viewer shows the sweeps one after the other; the
    channel `time` is the sweep's own clock, unchanged.
    """
    import asammdf
    from asammdf.blocks import v4_constants

    robot = recordings.robot
    with asammdf.MDF(version="4.10") as file:
        file.header.start_time = recordings.began
        file.header.subject = robot.name
        file.header.comment = f"sweeps of robot {robot.name}; what they are: {_DOCUMENT}"
        for sweep in recordings.sweeps:
            spec = sweep.spec
            kind = (v4_constants.SOURCE_OTHER, v4_constants.BUS_TYPE_NONE)
            source = asammdf.Source(spec.axis, robot.name, "a joint of the robot", *kind)
            signals = [
                asammdf.Signal(
                    samples=column,
                    timestamps=spec.started_at + sweep.recording.time,
                    name=name,
                    unit=_COLUMNS[name][recordings.slides(spec.axis)],
                    comment=_COLUMNS[name][2],
                    source=source,
                    master_metadata=("campaign_time", 1),  # sync type of a time in the standard
                )
                for name, column in columns_of(sweep.recording).items()
            ]
            file.append(
                signals, acq_name=spec.id, acq_source=source, comment=spec.model_dump_json(), common_timebase=True
            )
        for name, text, mime in recordings.attachments():
            file.attach(text.encode(), file_name=name, comment=name, mime=mime, compression=True, embedded=True)
        file.save(path, overwrite=True)


def _write_mcap(path: Path, recordings: _Recordings) -> None:
    """One topic per joint, one JSON message per sample, for plots in Foxglove.

    The time of a message, in ns, is the sum of the campaign's start, `started_at` and the time in the sweep; the
    message itself contains the time in the sweep.
    """
    from mcap.writer import Writer

    with path.open("wb") as stream:
        file = Writer(stream)
        file.start(profile="", library=f"sweepid {version('sweepid')}")
        schemas = {
            prismatic: file.register_schema(_schema_name(prismatic), "jsonschema", _schema(prismatic))
            for prismatic in sorted({recordings.slides(sweep.spec.axis) for sweep in recordings.sweeps})
        }
        topics: dict[str, int] = {}
        for sweep in sorted(recordings.sweeps, key=lambda sweep: sweep.spec.started_at):
            axis = sweep.spec.axis
            if axis not in topics:
                topics[axis] = file.register_channel(f"/{axis}", "json", schemas[recordings.slides(axis)])
            stamps = _nanoseconds(recordings.began, sweep).tolist()
            columns = {name: column.tolist() for name, column in columns_of(sweep.recording).items()}
            for number, (stamp, row) in enumerate(zip(stamps, zip(*columns.values(), strict=True), strict=True)):
                message = {"sweep": sweep.spec.id, **dict(zip(columns, row, strict=True))}
                data = json.dumps(message, separators=(",", ":")).encode()
                file.add_message(topics[axis], log_time=stamp, publish_time=stamp, sequence=number, data=data)
            spec = sweep.spec.model_dump(mode="json")
            told = {name: value if isinstance(value, str) else json.dumps(value) for name, value in spec.items()}
            file.add_metadata(f"sweep {sweep.spec.id}", told)
        began = _since_1970(recordings.began)
        for name, text, mime in recordings.attachments():
            file.add_attachment(create_time=began, log_time=began, name=name, media_type=mime, data=text.encode())
        file.finish()


def _nanoseconds(began: datetime, sweep: Sweep) -> NDArray[np.int64]:
    """Time of each sample since 1970, ns, (n,)."""
    begun, after = _since_1970(began), 1e9 * (sweep.spec.started_at + sweep.recording.time)
    if not (begun + after[0] >= 0 and begun + after[-1] < 2**63 - 1):
        raise BadInput(
            f"sweep {sweep.spec.id} started_at",
            f"{sweep.spec.started_at:.6g} s is outside the years 1970 to 2262, which MCAP can represent",
        )
    return begun + np.rint(after).astype(np.int64)


def _since_1970(moment: datetime) -> int:
    """ns"""
    return (moment - datetime.fromtimestamp(0, UTC)) // timedelta(microseconds=1) * 1000


def _schema_name(prismatic: bool) -> str:
    return "sweepid.SlidingJoint" if prismatic else "sweepid.TurningJoint"


def _schema(prismatic: bool) -> bytes:
    columns: Mapping[str, object] = {
        name: {"type": "number", "description": f"{_COLUMNS[name][prismatic]}: {_COLUMNS[name][2]}"}
        for name in (*REQUIRED_COLUMNS, *OPTIONAL_COLUMNS)
    }
    schema = {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": _schema_name(prismatic),
        "type": "object",
        "properties": {"sweep": {"type": "string", "description": "id of the sweep"}, **columns},
        "required": ["sweep", *REQUIRED_COLUMNS],
    }
    return json.dumps(schema).encode()
