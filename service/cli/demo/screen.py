"""Progress output of the demo."""

from collections.abc import Callable
from dataclasses import dataclass

from service.web.client import Json


@dataclass(frozen=True)
class Screen:
    """Output of the current action, of the campaign at each event, and of notes."""

    doing: Callable[[str], None]
    progress: Callable[[Json], None]
    say: Callable[[str], None]
