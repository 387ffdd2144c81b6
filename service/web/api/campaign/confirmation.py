"""Typed confirmation for a plan of another robot or cell than the machine's."""

from collections.abc import Mapping
from typing import Annotated

from fastapi import Depends, Query

Name = Annotated[str | None, Query(max_length=200)]


def _typed(confirm_robot: Name = None, confirm_cell: Name = None) -> Mapping[str, str | None]:
    return {"robot": confirm_robot, "cell": confirm_cell}


Typed = Annotated[Mapping[str, str | None], Depends(_typed)]
"""Names that a person typed, by "robot" and "cell" (query `confirm_robot`, `confirm_cell`). They are needed, and stored
with the plan, only if its robot or cell is not the machine's; the 409 `needs-confirmation` says what to type.
"""
