"""Result of a check: rows that a commissioning engineer reads and signs, as text and as JSON."""

import json
from collections import Counter
from collections.abc import Iterable
from dataclasses import asdict, dataclass, replace
from enum import Enum


class Verdict(Enum):
    """Meaning of a row for the person who signs."""

    FITS = "fits"
    HOST = "host"  # missing in the drive: the host, or what the map names, replaces it
    NOTE = "note"  # not determined, or for information
    MISMATCH = "MISMATCH"


@dataclass(frozen=True, slots=True)
class Row:
    """One item of the check. `check` is a permanent name; `what` is a sentence with values and limits."""

    joint: str  # "": the whole machine
    check: str
    verdict: Verdict
    what: str


@dataclass(frozen=True, slots=True)
class Sheet:
    """One check of one machine. `files`: SHA-256 of the files used."""

    profile: str
    made: str  # time, ISO 8601
    files: dict[str, str]
    excitation: dict[str, str]  # by joint
    rows: tuple[Row, ...]
    energy: str = "without energy"

    @property
    def mismatches(self) -> tuple[Row, ...]:
        return tuple(row for row in self.rows if row.verdict is Verdict.MISMATCH)

    def with_rows(self, rows: Iterable[Row], energy: str = "without energy") -> "Sheet":
        """The sheet with further rows."""
        return replace(self, rows=(*self.rows, *rows), energy=energy)

    def json(self) -> str:
        """The sheet as one document, `sound` first."""
        rows = [asdict(row) | {"verdict": row.verdict.value} for row in self.rows]
        return json.dumps({"sound": not self.mismatches} | asdict(self) | {"rows": rows}, indent=2)

    def text(self) -> str:
        """A table in plain text, the duties of the host, the mismatches again, and the line to sign."""
        lines = [f"Check of {self.profile} at {self.made}, {self.energy}", ""]
        lines += [f"{name}  SHA-256 {digest}" for name, digest in self.files.items()]
        lines += ["", *_table(self.rows)]
        lines += ["", *(f"{joint}: set-points by {way}" for joint, way in self.excitation.items())]
        lines += _listed("The host, not the drive:", (row for row in self.rows if row.verdict is Verdict.HOST))
        lines += _listed(f"Mismatches: {len(self.mismatches) or 'none'}", self.mismatches)
        end = (
            "NOT fit for motion: correct the mismatches and check again" if self.mismatches else "Fit for a first move"
        )
        return "\n".join(
            [*lines, "", end, "", "Checked by ____________________  Date ____________  Signature ____________________"]
        )


def _listed(title: str, rows: Iterable[Row]) -> list[str]:
    """Sentences under a title; a sentence that applies to several joints is printed once."""
    joints = Counter[tuple[str, str]]()
    names: dict[tuple[str, str], list[str]] = {}
    for row in rows:
        joints[row.check, row.what] += 1
        names.setdefault((row.check, row.what), []).append(row.joint or "machine")
    return ["", title, *(f"  {', '.join(names[key])}: {key[0]}: {key[1]}" for key in joints)]


def _table(rows: tuple[Row, ...]) -> list[str]:
    titles = ("axis", "check", "verdict", "what")
    cells = [(row.joint or "machine", row.check, row.verdict.value, row.what) for row in rows]
    widths = [max(map(len, column)) for column in zip(titles, *cells, strict=True)][:3]
    return [
        "  ".join([*(cell.ljust(width) for cell, width in zip(line, widths, strict=False)), line[3]])
        for line in (titles, *cells)
    ]
