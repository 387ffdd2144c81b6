"""One thing that a person should know of a maker's URDF before it is used."""

from dataclasses import dataclass
from typing import Literal


@dataclass(frozen=True)
class Finding:
    """`missing`: to be completed by a person; `changed`: what was made of it; `unusual`: look whether it is meant."""

    kind: Literal["missing", "changed", "unusual"]
    place: str  # link, joint or file
    sentence: str
