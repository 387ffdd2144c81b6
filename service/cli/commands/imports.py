"""`sweepid import`: bundles into the service, traces of a CNC or a test bench to bundles."""

from __future__ import annotations

import math
import sys
import tempfile
import zipfile
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from service import BadInput, writing
from service.cli.terminal import DEFAULT_URL, Url, connect, put_json, waiting, write_file

if TYPE_CHECKING:
    from rich.console import Console

    from service.data_check import DataFinding
    from service.formats.sinumerik.document import (
        Given,
        LoopInertia,
        MeasuredResponse,
        ResponseColumns,
        ServoTuning,
        Size,
    )
    from service.model import Array


def import_bundle(
    bundle: Annotated[Path, typer.Argument(help="Folder of a bundle, or a zip of it.")], url: Url = DEFAULT_URL
) -> None:
    """Bring measured sweeps into the service, which identifies them. Prints the number of the campaign.

    What a check of the data finds goes to stderr.
    """
    import asyncio

    from service.store.files.bundle import pack
    from service.store.files.isolated_reader import read_isolated

    with connect(url) as client, tempfile.TemporaryDirectory() as folder:
        if bundle.is_dir() and not (bundle / "bundle.json").is_file():
            raise BadInput(str(bundle / "bundle.json"), "does not exist")
        archive = pack(bundle, Path(folder) / "bundle.zip") if bundle.is_dir() else bundle
        if not zipfile.is_zipfile(archive):
            raise BadInput(str(bundle), "is neither the folder of a bundle nor a zip file")
        with waiting("the service reads the bundle"):
            campaign = client.import_bundle(archive)
        sys.stdout.write(f"{campaign['id']}\n")
        try:
            lines: list[str] = asyncio.run(read_isolated(findings_of, (bundle, Path(folder) / "bundle"), str(bundle)))
        except BadInput as error:  # it is imported all the same, and the service checks it too
            lines = [f"not checked: {error}"]
        for line in lines:
            typer.echo(line, err=True)


def import_trace(
    mapping: Annotated[
        Path,
        typer.Argument(
            help="Trace file; or mapping file (YAML); or a Sinumerik's measurement (XML).", show_default=False
        ),
    ],
    out: Annotated[
        Path | None, typer.Option(help="Directory of the new bundle, or of a measurement's tables; must be empty.")
    ] = None,
    source: Annotated[Path | None, typer.Option(help="Trace file in place of the one that the mapping names.")] = None,
    axis: Annotated[
        str | None, typer.Option(help="Trace: number or name of the axis, of a file of several.", metavar="AXIS")
    ] = None,
    kind: Annotated[str | None, typer.Option(help="Trace: revolute or prismatic.")] = None,
    gear_ratio: Annotated[
        float | None,
        typer.Option(help="Trace, XML: motor rad per joint rad (m); a negative one turns against the joint."),
    ] = None,
    rated_effort: Annotated[
        float | None, typer.Option(min=1e-9, help="Trace: rated torque of the joint, N m (N), for channels in percent.")
    ] = None,
    torque_constant: Annotated[
        float | None, typer.Option(min=1e-9, help="Trace: of the motor, N m/A, for channels in A.")
    ] = None,
    inertia: Annotated[
        float | None, typer.Option(min=1e-12, help="Trace: nominal inertia about the axis, kg m^2 (kg).")
    ] = None,
    sample_rate: Annotated[float | None, typer.Option(min=1e-3, help="Trace: Hz, of a file without time.")] = None,
    draft: Annotated[
        Path | None, typer.Option(help="Trace: write the mapping with all that was found, to be edited.")
    ] = None,
    speed_gain: Annotated[
        float | None, typer.Option(min=1e-12, help="XML: gain of the speed controller, p1460, N m s/rad.")
    ] = None,
    reset_time: Annotated[
        float | None,
        typer.Option(min=1e-6, help="XML: reset time of an integral part without reference model, p1462, s."),
    ] = None,
    json_to: Annotated[
        str | None, typer.Option("--json", help="XML: write JSON here; - is stdout.", metavar="FILE")
    ] = None,
) -> None:
    """Turn a trace of a control, drive or robot into a bundle, by its content; or read what a Sinumerik measured."""

    trace = {"--axis": axis, "--kind": kind, "--rated-effort": rated_effort, "--torque-constant": torque_constant,
             "--inertia": inertia, "--sample-rate": sample_rate, "--draft": draft}  # fmt: skip
    response = {"--speed-gain": speed_gain, "--reset-time": reset_time, "--json": json_to}
    if is_measurement(mapping):
        if source is not None:
            raise BadInput("--source", f"{mapping} is the measurement itself, not a mapping")
        _refuse(trace, f"does not apply to a measurement of a Sinumerik, {mapping}")
        from service.formats.sinumerik.document import Given

        import_control_file(mapping, Given(speed_gain, reset_time, gear_ratio), out, json_to)
        return
    _refuse(response, f"applies only to a measurement of a Sinumerik (.xml); {mapping} is none")
    if mapping.suffix.lower() in (".yaml", ".yml"):
        _refuse(
            trace | {"--gear-ratio": gear_ratio}, f"applies only to a trace; {mapping} is a mapping and says it itself"
        )
    elif source is not None:
        raise BadInput("--source", f"{mapping} is the trace itself, not a mapping")
    if out is None:
        raise BadInput("--out", "is missing: give the directory of the new bundle")
    from service.data_check import check
    from service.formats.traces.trace_import import mapping_of, mapping_text, read_traces
    from service.store.files.bundle import write_bundle

    with waiting("reading the traces"):
        given = mapping_of(
            mapping, axis=axis, kind=kind, gear_ratio=gear_ratio, rated_effort=rated_effort,
            torque_constant=torque_constant, inertia=inertia, sample_rate=sample_rate,
        )  # fmt: skip
        made = read_traces(given, mapping, source)
        with writing(out):
            write_bundle(out, made.robot, made.sweeps)
    for note in made.notes:
        typer.echo(f"guess: {note}", err=True)
    if draft is not None:
        write_file(draft, mapping_text(made).rstrip("\n"))
    warn(check(made.robot, made.sweeps))
    count = len(made.sweeps)
    typer.echo(f"{out}: {count} sweep{'s' if count > 1 else ''} of {made.robot.name}", err=True)


def _refuse(options: Mapping[str, object], reason: str) -> None:
    for name, value in options.items():
        if value is not None:
            raise BadInput(name, reason)


def findings_of(source: Path, folder: Path) -> list[str]:
    """What a check of the data finds, one line each; a zip is unpacked into `folder`."""
    from service.data_check import check
    from service.store.files.bundle import read_from

    measured = read_from(source, folder)
    return as_lines(check(measured.robot, measured.sweeps))


def warn(findings: Sequence[DataFinding]) -> None:
    """To stderr."""
    for line in as_lines(findings):
        typer.echo(line, err=True)


def as_lines(findings: Sequence[DataFinding]) -> list[str]:
    """One a finding."""
    return [f"{one.severity}: {one.sentence} {one.action}" for one in findings]


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
    from rich.console import Console

    from service.formats.sinumerik import measurement
    from service.formats.sinumerik.document import (
        measurement_document,
        recording_table,
        response_table,
        tuning_document,
    )
    from service.formats.sinumerik.members import read_members

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
        more = f" and {len(unread) - 6} more (all in the JSON)" if len(unread) > 6 else ""
        typer.echo(f"{path}: members not read: {', '.join(unread[:6])}{more}", err=True)
    if put_json(document, json_to):
        return
    _print(document, Console())


def _write(out: Path, text: str, tables: dict[str, dict[str, Array]]) -> None:
    import numpy as np

    with writing(out):
        out.mkdir(parents=True, exist_ok=True)
        if any(out.iterdir()):
            raise BadInput(str(out), "is not empty")
        (out / "measurement.json").write_text(text + "\n", encoding="utf-8")
        for name, columns in tables.items():
            rows = np.stack(list(columns.values()), -1)
            np.savetxt(out / f"{name}.csv", rows, delimiter=",", header=",".join(columns), comments="", fmt="%.17g")


def _print(document: MeasuredResponse | ServoTuning, console: Console) -> None:
    from service.formats.sinumerik.document import MeasuredResponse, ServoTuning

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
    import numpy as np

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
