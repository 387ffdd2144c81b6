"""`sweepid check`: is the data fit for physics, and is the robot still the one of its sheet?"""

from pathlib import Path
from typing import Annotated

import typer

import sweepid
from service.cli.options import DEFAULT_URL, Bundle, JsonTo, Url
from service.model.errors import BadInput


def check(
    bundle: Bundle,
    json_to: JsonTo = None,
) -> None:
    """Tell what is wrong with recordings and robot file, before any physics."""
    from service.cli.documents import put_json
    from service.cli.progress_indicator import waiting

    with waiting("checking the data"):
        found = sweepid.check(bundle)
    if not put_json(found, json_to):
        from service.cli.tables import print_result

        print_result(found)


def check_sheet(
    sheet: Annotated[
        Path, typer.Argument(help="JSON file of `sweepid export sheet --json`.", metavar="SHEET", show_default=False)
    ],
    bundle: Annotated[Path | None, typer.Argument(help="Bundle that was measured later.", metavar="[BUNDLE]")] = None,
    campaign: Annotated[
        int | None, typer.Option(help="Number of a campaign that was measured later.", metavar="N", min=1)
    ] = None,
    url: Url = DEFAULT_URL,
    json_to: JsonTo = None,
) -> None:
    """Compare a later measurement with a sheet, axis by axis, with significance. Exit code 1: the robot differs."""
    from service.cli.documents import put_json
    from service.cli.exports.check_sheet import as_text, of_bundle, of_campaign
    from service.cli.progress_indicator import waiting
    from service.formats.export.sheets.making import compare
    from service.model.results.identified.sheet import Sheet
    from sweepid.files import read_document

    stored = read_document(sheet, Sheet)
    if (bundle is None) == (campaign is None):
        raise BadInput("BUNDLE", "name either a bundle or a campaign (--campaign N) that was measured later")
    with waiting("the comparison"):
        if bundle is not None:
            robot, estimate, poses = of_bundle(bundle)
        else:
            robot, estimate, poses = of_campaign(campaign or 0, url)
        found = compare(stored, robot, estimate, poses, str(bundle or f"campaign {campaign}"))
    if not put_json(found, json_to):
        typer.echo(as_text(found))
    if found.verdict != "the same":
        raise typer.Exit(1)
