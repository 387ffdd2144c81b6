"""What a Sinumerik measured of itself, on the terminal, as JSON and as tables."""

import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import typer
from numpy.typing import NDArray
from rich.console import Console

from service.cli.documents import put_json
from service.formats.sinumerik import measurement
from service.formats.sinumerik.document import (
    Given,
    LoopInertia,
    MeasuredResponse,
    ResponseColumns,
    ServoTuning,
    Size,
    measurement_document,
    recording_table,
    response_table,
    tuning_document,
)
from service.formats.sinumerik.members import read_members
from service.model.errors import BadInput, writing

Array = NDArray[np.float64]

SOME = 6  # unread members that stderr names; all of them stand in the JSON


def is_measurement(path: Path) -> bool:
    """True for XML that is no trace of time."""
    if path.suffix.lower() != ".xml" and path.suffix.lower() in (".yaml", ".yml"):
        return False
    try:
        with path.open("rb") as file:
            head = file.read(4096)
    except OSError:
        return path.suffix.lower() == ".xml"  # its reader tells what is wrong
    mark = head.replace(b"\0", b"").lstrip(b"\xef\xbb\xbf\xff\xfe \r\n")
    return (mark.startswith(b"<") or path.suffix.lower() == ".xml") and b"<traceSession" not in head.replace(b"\0", b"")


def import_control_file(path: Path, given: Given, out: Path | None, json_to: str | None) -> None:
    """Read, print or write; BadInput for what is not of the family."""
    root = read_members(path)
    if root.kind == measurement.TUNING:
        tuned = measurement.tuning_of(root)
        document, tables = tuning_document(tuned, given, str(path)), {"frequency_response": response_table(tuned)}
    else:
        found = measurement.measurement_of(root)
        document = measurement_document(found, given, str(path))
        tables = {"frequency_response": response_table(found), "recording": recording_table(found)}
    if out is not None:
        _write(out, document.to_json(), tables)
    if unread := document.unread:
        more = f" and {len(unread) - SOME} more (all in the JSON)" if len(unread) > SOME else ""
        typer.echo(f"{path}: members not read: {', '.join(unread[:SOME])}{more}", err=True)
    if put_json(document, json_to):
        return
    _print(document, Console())


def _write(out: Path, text: str, tables: dict[str, dict[str, Array]]) -> None:
    with writing(out):
        out.mkdir(parents=True, exist_ok=True)
        if any(out.iterdir()):
            raise BadInput(str(out), "is not empty")
        (out / "measurement.json").write_text(text + "\n", encoding="utf-8")
        for name, columns in tables.items():
            rows = np.stack(list(columns.values()), -1)
            np.savetxt(out / f"{name}.csv", rows, delimiter=",", header=",".join(columns), comments="", fmt="%.17g")


def _print(document: MeasuredResponse | ServoTuning, console: Console) -> None:
    def line(text: str) -> None:
        console.print(text, highlight=False, markup=False, soft_wrap=True)

    line(f"{document.kind} of {document.axis}, {document.measured_at}, version {document.version}")
    if isinstance(document, MeasuredResponse):
        excitation = document.excitation
        line(f"{document.output} over {document.input}")
        line(
            f"{excitation.signal}, {1e6 * excitation.sample_interval:g} us apart, {excitation.directions} "
            f"directions; amplitude {excitation.amplitude:.4g} {excitation.unit} on "
            f"{excitation.offset_rpm:.4g} rpm, up to {excitation.bandwidth:g} Hz"
        )
    for way, inertia in document.inertia.items():
        line(f"by {way.replace('_', ' ')}: {_inertia(inertia)}")
    if isinstance(document, ServoTuning):
        line(f"the control's own: {document.by_control.total_inertia:.4g} kg m^2, without uncertainty")
    _print_response(document.frequency_response, line)
    for what in document.cannot_tell:
        line(f"not determined: {what}")


def _print_response(response: ResponseColumns, line: Callable[[str], None]) -> None:
    """A line an octave; the whole table is in the JSON."""
    line("Hz, amplitude, phase in deg" + (", coherence" if response.coherence else ""))
    frequency = np.array(response.frequency)
    values = np.array(response.re) + 1j * np.array(response.im)
    first, last = np.log2(frequency[frequency > 0][0]), np.log2(frequency[-1])
    octaves = [2.0**power for power in range(math.ceil(first), math.ceil(last))]
    for k in dict.fromkeys(int(np.argmin(np.abs(frequency - octave))) for octave in octaves):
        phase = float(np.degrees(np.angle(values[k])))
        coherence = f" {response.coherence[k]:8.5f}" if response.coherence else ""
        line(f"{frequency[k]:9.2f} {abs(values[k]):10.5f} {phase:8.1f}{coherence}")


def _inertia(inertia: LoopInertia) -> str:
    low, high = inertia.band
    where = f"from {inertia.lines} lines of {low:.3g} to {high:.3g} Hz, misfit {inertia.misfit_percent:.1f} %"
    motor, axis, over = inertia.motor_side, inertia.axis_side, inertia.over_gain
    if motor is not None and axis is not None:
        return f"J = {_size(motor)} kg m^2 on the motor side, {_size(axis)} {inertia.axis_unit} on the axis' {where}"
    return where if over is None else f"J/K = {_size(over, 1e3)} ms {where}"


def _size(size: Size, scale: float = 1.0) -> str:
    return f"{scale * size.value:.4g} +- {scale * size.std:.2g}"
