"""MDF 4.10: one channel group per sweep, named by its id; the joint is the source. Needs `sweepid[mdf4]`.

The group's master starts at the beginning of the campaign, so a viewer shows the sweeps one after the other; the
channel `time` is the sweep's own clock, unchanged.
"""

from pathlib import Path

import asammdf
from asammdf.blocks import v4_constants

from service.formats.export.recordings.metadata import DOCUMENT, MEANINGS, URDF, Recordings, document, slides, unit_of
from service.model.recording import Sweep
from service.store.files.columns import columns_of

MASTER = "campaign_time"
_TIME = 1  # sync type of the master in the standard


def write(path: Path, recordings: Recordings) -> None:
    with asammdf.MDF(version="4.10") as file:
        file.header.start_time = recordings.began
        file.header.subject = recordings.robot.name
        file.header.comment = f"sweeps of robot {recordings.robot.name}; what they are: {DOCUMENT}"
        for sweep in recordings.sweeps:
            _append(file, recordings, sweep)
        for name, text, mime in (
            (DOCUMENT, document(recordings), "application/json"),
            (URDF, recordings.robot.urdf_text, "application/xml"),
        ):
            file.attach(text.encode(), file_name=name, comment=name, mime=mime, compression=True, embedded=True)
        file.save(path, overwrite=True)


def _append(file: asammdf.MDF, recordings: Recordings, sweep: Sweep) -> None:
    spec, robot = sweep.spec, recordings.robot
    source = asammdf.Source(
        spec.axis, robot.name, "a joint of the robot", v4_constants.SOURCE_OTHER, v4_constants.BUS_TYPE_NONE
    )
    timestamps = spec.started_at + sweep.recording.time
    prismatic = slides(robot, spec.axis)
    signals = [
        asammdf.Signal(
            samples=column,
            timestamps=timestamps,
            name=name,
            unit=unit_of(name, prismatic),
            comment=MEANINGS[name],
            source=source,
            master_metadata=(MASTER, _TIME),
        )
        for name, column in columns_of(sweep.recording).items()
    ]
    file.append(signals, acq_name=spec.id, acq_source=source, comment=spec.model_dump_json(), common_timebase=True)
