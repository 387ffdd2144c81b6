"""Where the demo tells how far it is."""

from collections.abc import Callable
from dataclasses import dataclass

from service.client import Json


@dataclass(frozen=True)
class Screen:
    """What it does, the campaign at each event, a note."""

    doing: Callable[[str], None]
    progress: Callable[[Json], None]
    say: Callable[[str], None]
