"""The check of the data: do recordings, set-points and robot file fit together?"""

from typing import Literal

from service.results.part import Document, Part


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


class DataCheck(Document):
    """Do recordings, set-points and robot file fit together?"""

    findings: tuple[Finding, ...]
    axes: dict[str, CheckedAxis]
