"""`sweepid report OF`: what is known of a campaign, a diagnosis, a bundle or a result, to read, print and keep."""

import sys
from pathlib import Path
from typing import Annotated, Literal

import typer

from service import BadInput
from service.cli.terminal import DEFAULT_URL, Url, connect, waiting, write_report

Form = Literal["html", "pdf", "json"]


def report(
    of: Annotated[
        str,
        typer.Argument(
            metavar="CAMPAIGN|BUNDLE|RESULT",
            help="Number of a campaign, directory of a bundle, or file of `identify --json` or `diagnose --json`.",
            show_default=False,
        ),
    ],
    file: Annotated[Path | None, typer.Argument(metavar="[FILE]", help="HTML file to write.")] = None,
    pdf: Annotated[Path | None, typer.Option(help="Write it as PDF (A4), too.", metavar="FILE")] = None,
    tables: Annotated[Path | None, typer.Option(help="Write its tables here, CSV and JSON.", metavar="DIR")] = None,
    diagnosis: Annotated[bool, typer.Option("--diagnosis", help="The number is that of a diagnosis.")] = False,
    url: Url = DEFAULT_URL,
) -> None:
    """Write a report: verdict, origin, figures, tables and findings. Prints the files."""

    places: dict[Form, Path | None] = {"html": file, "pdf": pdf, "json": tables}
    wanted: list[tuple[Form, Path]] = [(form, path) for form, path in places.items() if path is not None]
    if not wanted:
        raise BadInput("FILE", "is missing: name a file, or one with --pdf, or a folder with --tables")
    with waiting("drawing the report"):
        if of.isdecimal():
            written = _of_service(int(of), diagnosis, [form for form, _ in wanted], url)
        else:
            from service.cli.report_pages import result_page

            page = result_page(Path(of))
            written = [page.written(form) for form, _ in wanted]
    for (form, path), content in zip(wanted, written, strict=True):
        write_report(form, path, content)
        sys.stdout.write(f"{path}\n")


def _of_service(number: int, diagnosis: bool, forms: list[Form], url: str) -> list[str | bytes]:
    with connect(url) as client:
        drawn = client.diagnosis_report if diagnosis else client.campaign_report
        return [drawn(number, form) for form in forms]
