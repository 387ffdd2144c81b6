"""MCAP: one topic per joint, one JSON message per sample, for plots in Foxglove. Needs `sweepid[mcap]`.

The time of a message, in ns, is the sum of the campaign's start, `started_at` and the time in the sweep; the
message itself contains the time in the sweep.
"""

import json
from collections.abc import Mapping
from datetime import UTC, datetime, timedelta
from importlib.metadata import version
from pathlib import Path

import numpy as np
from mcap.writer import Writer
from numpy.typing import NDArray

from service.formats.export.recordings.metadata import DOCUMENT, MEANINGS, URDF, Recordings, document, slides, unit_of
from service.model.errors import BadInput
from service.model.recording import OPTIONAL_COLUMNS, REQUIRED_COLUMNS, Sweep
from service.store.files.columns import columns_of

_LATEST = 2**63 - 1  # ns
_NS = 10**9


def write(path: Path, recordings: Recordings) -> None:
    robot = recordings.robot
    with path.open("wb") as stream:
        file = Writer(stream)
        file.start(profile="", library=f"sweepid {version('sweepid')}")
        schemas = {
            prismatic: file.register_schema(_schema_name(prismatic), "jsonschema", _schema(prismatic))
            for prismatic in sorted({slides(robot, sweep.spec.axis) for sweep in recordings.sweeps})
        }
        topics: dict[str, int] = {}
        for sweep in sorted(recordings.sweeps, key=lambda sweep: sweep.spec.started_at):
            axis = sweep.spec.axis
            if axis not in topics:
                topics[axis] = file.register_channel(f"/{axis}", "json", schemas[slides(robot, axis)])
            _add(file, topics[axis], sweep, _nanoseconds(recordings.began, sweep))
        began = _since_1970(recordings.began)
        for name, text, kind in (
            (DOCUMENT, document(recordings), "application/json"),
            (URDF, robot.urdf_text, "application/xml"),
        ):
            file.add_attachment(create_time=began, log_time=began, name=name, media_type=kind, data=text.encode())
        file.finish()


def _add(file: Writer, topic: int, sweep: Sweep, stamps: NDArray[np.int64]) -> None:
    columns = {name: column.tolist() for name, column in columns_of(sweep.recording).items()}
    names = tuple(columns)
    for number, (stamp, row) in enumerate(zip(stamps.tolist(), zip(*columns.values(), strict=True), strict=True)):
        message = {"sweep": sweep.spec.id, **dict(zip(names, row, strict=True))}
        data = json.dumps(message, separators=(",", ":")).encode()
        file.add_message(topic, log_time=stamp, publish_time=stamp, sequence=number, data=data)
    spec = sweep.spec.model_dump(mode="json")
    file.add_metadata(f"sweep {sweep.spec.id}", {name: _text(value) for name, value in spec.items()})


def _text(value: object) -> str:
    return value if isinstance(value, str) else json.dumps(value)


def _nanoseconds(began: datetime, sweep: Sweep) -> NDArray[np.int64]:
    """Time of each sample since 1970, ns, (n,)."""
    seconds = sweep.spec.started_at + sweep.recording.time
    begun = _since_1970(began)
    if not (begun + seconds[0] * _NS >= 0 and begun + seconds[-1] * _NS < _LATEST):
        place = f"sweep {sweep.spec.id} started_at"
        raise BadInput(
            place, f"{sweep.spec.started_at:.6g} s is outside the years 1970 to 2262, which MCAP can represent"
        )
    return begun + np.rint(seconds * _NS).astype(np.int64)


def _since_1970(moment: datetime) -> int:
    return (moment - datetime.fromtimestamp(0, UTC)) // timedelta(microseconds=1) * 1000


def _schema_name(prismatic: bool) -> str:
    return "sweepid.SlidingJoint" if prismatic else "sweepid.TurningJoint"


def _schema(prismatic: bool) -> bytes:
    columns: Mapping[str, object] = {
        name: {"type": "number", "description": f"{unit_of(name, prismatic)}: {MEANINGS[name]}"}
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
