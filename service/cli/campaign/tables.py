"""The tables of a report as files: all as JSON, and each as CSV."""

import csv
import io
import json
import re
from pathlib import Path

from service.cli.documents import write_file
from service.errors import BadInput


def write_tables(folder: Path, content: str | bytes) -> None:
    """`content`: the report's JSON form. Makes the folder; BadInput if that cannot be."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise BadInput(str(folder), f"cannot be made: {error.strerror or error}") from None
    write_file(folder / "tables.json", content)
    for number, table in enumerate(json.loads(content)["tables"], start=1):
        text = io.StringIO()
        csv.writer(text, lineterminator="\n").writerows([table["head"], *table["rows"]])
        words = re.sub(r"[^a-z0-9]+", "-", table["section"].lower()).strip("-")
        write_file(folder / f"{number:02d}-{words[:60]}.csv", text.getvalue().rstrip("\n"))
