"""A finding about a manufacturer's URDF that the user should read before its use."""

from dataclasses import dataclass
from typing import Literal


@dataclass(frozen=True)
class Finding:
    """`missing`: the user must complete it; `changed`: modified here; `unusual`: the user should check it."""

    kind: Literal["missing", "changed", "unusual"]
    place: str  # link, joint or file
    sentence: str
