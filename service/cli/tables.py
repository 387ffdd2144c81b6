"""Results on the terminal."""

from rich.console import Console
from rich.table import Table as RichTable

from service.model.results.table import Shown, Table


def print_result(found: Shown, console: Console | None = None) -> None:
    """Its tables, fitted to the terminal, and its sentences. `console` None: stdout."""
    console = console or Console()
    for part in found.shown():
        if isinstance(part, Table):
            console.print(_table(part))
        else:
            console.print(part, highlight=False, markup=False, soft_wrap=True)


def _table(table: Table) -> RichTable:
    wide = any(len(text) > 60 for column in table.columns for text in column.texts)  # sentences, of several lines
    shown = RichTable(title=table.title, show_lines=wide)
    for column in table.columns:
        side = "right" if column.numeric else "left"
        shown.add_column(column.name, justify=side, overflow="fold", no_wrap=column.whole)
    for row in zip(*(column.texts for column in table.columns), strict=True):
        shown.add_row(*row)
    return shown
