"""`sweepid import`: bundles into the service, traces of a CNC or a test bench to bundles."""

import sys
import tempfile
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated

import typer

from service.cli.options import DEFAULT_URL, Url
from service.model.errors import BadInput, writing


def import_bundle(
    bundle: Annotated[Path, typer.Argument(help="Folder of a bundle, or a zip of it.")],
    url: Url = DEFAULT_URL,
) -> None:
    """Bring measured sweeps into the service, which identifies them. Prints the number of the campaign.

    What a check of the data finds goes to stderr.
    """
    import asyncio

    from service.cli.campaign.import_check import findings_of
    from service.cli.progress_indicator import waiting
    from service.store.files.isolated_reader import read_isolated
    from service.web.client import ServiceClient

    with ServiceClient(url) as client, tempfile.TemporaryDirectory() as folder:
        archive = _pack(bundle, Path(folder) / "bundle.zip") if bundle.is_dir() else bundle
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


def _pack(folder: Path, target: Path) -> Path:
    if not (folder / "bundle.json").is_file():
        raise BadInput(str(folder / "bundle.json"), "does not exist")
    with zipfile.ZipFile(target, "w", zipfile.ZIP_STORED) as archive:  # Parquet is compressed already
        for path in sorted(folder.rglob("*")):
            archive.write(path, path.relative_to(folder))
    return target


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
    from service.cli.recordings.control_file import is_measurement

    trace = {"--axis": axis, "--kind": kind, "--rated-effort": rated_effort, "--torque-constant": torque_constant,
             "--inertia": inertia, "--sample-rate": sample_rate, "--draft": draft}  # fmt: skip
    response = {"--speed-gain": speed_gain, "--reset-time": reset_time, "--json": json_to}
    if is_measurement(mapping):
        if source is not None:
            raise BadInput("--source", f"{mapping} is the measurement itself, not a mapping")
        _refuse(trace, f"does not apply to a measurement of a Sinumerik, {mapping}")
        from service.cli.recordings.control_file import import_control_file
        from service.formats.sinumerik.document import Given

        import_control_file(mapping, Given(speed_gain, reset_time, gear_ratio), out, json_to)
        return
    _refuse(response, f"applies only to a measurement of a Sinumerik (.xml); {mapping} is none")
    if mapping.suffix.lower() in (".yaml", ".yml"):
        _refuse(
            trace | {"--gear-ratio": gear_ratio},
            f"applies only to a trace; {mapping} is a mapping and says it itself",
        )
    elif source is not None:
        raise BadInput("--source", f"{mapping} is the trace itself, not a mapping")
    if out is None:
        raise BadInput("--out", "is missing: give the directory of the new bundle")
    from service.cli.documents import write_file
    from service.cli.progress_indicator import waiting
    from service.cli.recordings.check import warn
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
