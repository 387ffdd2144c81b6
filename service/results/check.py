"""The check of the data: do recordings, set-points and robot file fit together?"""

from typing import Literal

from service.results.part import Document, Part


class Finding(Part):
    """`severity` wrong: no physics of the `axis` (null: of the whole robot) can be trusted; warning: read it.

    `value` and `limit` are of one unit, which the sentence names; null where there is none.
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
    """An axis that was swept, and the codes of what was found about it."""

    sweeps: int
    trustworthy: bool
    codes: tuple[str, ...]


class DataCheck(Document):
    """Do recordings, set-points and robot file fit together?"""

    findings: tuple[Finding, ...]
    axes: dict[str, CheckedAxis]
