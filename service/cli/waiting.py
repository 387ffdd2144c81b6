"""What a command that takes its time shows meanwhile: on a terminal alone, and on stderr."""

from collections.abc import Generator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import Progress, SpinnerColumn, TextColumn, TimeElapsedColumn


@contextmanager
def waiting(for_what: str) -> Generator[None]:
    """While the block runs, a line says what is waited for and for how long already; it is gone afterwards."""
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
        yield
