"""Progress line of a long command: only on a terminal, on stderr."""

from collections.abc import Generator
from contextlib import contextmanager
from contextvars import ContextVar

from rich.console import Console
from rich.progress import Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

_shown: ContextVar[bool] = ContextVar("shown", default=False)


@contextmanager
def waiting(for_what: str) -> Generator[None]:
    """While the block runs, a line shows the current work and the elapsed time; it is removed afterwards.

    In the block of another, the line of the other stays.
    """
    if _shown.get():
        yield
        return
    console = Console(stderr=True)
    columns = (SpinnerColumn(), TextColumn("{task.description}"), TimeElapsedColumn())
    with Progress(
        *columns,
        console=console,
        transient=True,
        redirect_stdout=False,  # results go there
        redirect_stderr=False,
        disable=not console.is_terminal,
    ) as bars:
        bars.add_task(for_what, total=None)
        token = _shown.set(True)
        try:
            yield
        finally:
            _shown.reset(token)
