"""Progress of a long command: only on a terminal, on stderr."""

import sys
from collections.abc import Generator, Iterable, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from typing import TypeVar

Item = TypeVar("Item")

_shown: ContextVar[bool] = ContextVar("shown", default=False)


@contextmanager
def waiting(for_what: str) -> Generator[None]:
    """While the block runs, a line shows the current work and the elapsed time; it is removed afterwards.

    In the block of another, the line of the other stays.
    """
    if _shown.get() or not sys.stderr.isatty():
        yield
        return
    from rich.console import Console
    from rich.progress import Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

    columns = (SpinnerColumn(), TextColumn("{task.description}"), TimeElapsedColumn())
    with Progress(
        *columns,
        console=Console(stderr=True),
        transient=True,
        redirect_stdout=False,  # results go there
        redirect_stderr=False,
    ) as bars:
        bars.add_task(for_what, total=None)
        token = _shown.set(True)
        try:
            yield
        finally:
            _shown.reset(token)


def counted(items: Sequence[Item], of_what: str) -> Iterable[Item]:
    """The items; while they are gone through, a bar shows how many are done."""
    if not sys.stderr.isatty():
        return items
    from rich.console import Console
    from rich.progress import track

    return track(items, of_what, console=Console(stderr=True), transient=True)
