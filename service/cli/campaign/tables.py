"""The tables of a report as files: all as JSON, and each as CSV."""

import csv
import io
import json
import re
from pathlib import Path

from service.cli.documents import write_file


def write_tables(folder: Path, content: str | bytes) -> None:
    """`content`: the report's JSON form. BadInput if they cannot be written."""
    write_file(folder / "tables.json", content)
    for number, table in enumerate(json.loads(content)["tables"], start=1):
        text = io.StringIO()
        csv.writer(text, lineterminator="\n").writerows([table["head"], *table["rows"]])
        words = re.sub(r"[^a-z0-9]+", "-", table["section"].lower()).strip("-")
        write_file(folder / f"{number:02d}-{words[:60]}.csv", text.getvalue().rstrip("\n"))
