"""The check of the data: do recordings, set-points and robot file fit together?"""

from collections.abc import Sequence
from typing import Literal

from service.model.results.part import Document, Part
from service.model.results.table import Column, Shown, Table


class Finding(Part):
    """`severity` wrong: the physics of the `axis` (null: of the whole robot) cannot be trusted; warning: read it.

    `value` and `limit` have the unit given in the sentence; null if there is no number.
    """

    code: str
    severity: Literal["wrong", "warning"]
    axis: str | None
    sweeps: tuple[str, ...]
    value: float | None
    limit: float | None
    sentence: str
    action: str


class CheckedAxis(Part):
    """A swept axis, and the codes of its findings."""

    sweeps: int
    trustworthy: bool
    codes: tuple[str, ...]


class DataCheck(Shown, Document):
    """Do recordings, set-points and robot file fit together?"""

    findings: tuple[Finding, ...]
    axes: dict[str, CheckedAxis]

    @property
    def _what(self) -> str:
        count = sum(axis.sweeps for axis in self.axes.values())
        return f"{count} sweep{'s' * (count > 1)}"

    def table(self) -> Table:
        """One row a finding: what was found and what to do."""
        return Table(
            f"Check of {self._what}",
            (
                Column("", tuple(one.severity for one in self.findings)),
                Column("what", tuple(one.code for one in self.findings)),
                Column("found", tuple(one.sentence for one in self.findings)),
                Column("to do", tuple(one.action for one in self.findings)),
            ),
        )

    def shown(self) -> Sequence[Table | str]:
        """The findings, or that there is none."""
        return (self.table(),) if self.findings else (f"Nothing found in {self._what}.",)
