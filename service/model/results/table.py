"""Tables of a result: for a terminal, a notebook, NumPy and pandas."""

from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from itertools import zip_longest
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from service.model.recording import SweepSpec
from service.model.results.digits import with_std

if TYPE_CHECKING:
    import pandas as pd

Value = str | int | float | None


@dataclass(frozen=True)
class Column:
    """Name and values; `form` is the format of its numbers, `whole`: never break a text. None: there is no value.

    `std`: standard deviations that decide the digits instead of `form`.
    """

    name: str
    values: tuple[Value, ...]
    form: str = ".5g"
    whole: bool = False
    std: tuple[float | None, ...] = ()

    @property
    def numeric(self) -> bool:
        """Whether there is no text in it."""
        return not any(isinstance(value, str) for value in self.values)

    @property
    def texts(self) -> tuple[str, ...]:
        """The values as a person reads them."""
        return tuple(self._text(value, std) for value, std in zip_longest(self.values, self.std))

    def _text(self, value: Value, std: float | None) -> str:
        if value is None:
            return "–"
        if not isinstance(value, float):
            return str(value)
        return f"{value:{self.form}}" if std is None else with_std(value, std)[0]


@dataclass(frozen=True)
class Table:
    """Columns of one length below a title."""

    title: str
    columns: tuple[Column, ...]

    def __getitem__(self, name: str) -> NDArray[Any]:
        """Values of a column as an array, NaN where there is none."""
        column = next(column for column in self.columns if column.name == name)
        if not column.numeric:
            return np.array(["" if value is None else value for value in column.values], dtype=object)
        return np.array([np.nan if value is None else value for value in column.values], dtype=float)

    def to_pandas(self) -> "pd.DataFrame":
        """The columns as a frame. ImportError without pandas, which sweepid does not require."""
        import pandas as pd

        return pd.DataFrame({column.name: self[column.name] for column in self.columns})

    def __str__(self) -> str:
        cells = [[column.name, *column.texts] for column in self.columns]
        widths = [max(map(len, column)) for column in cells]
        lines = [
            "  ".join(
                cell.rjust(width) if column.numeric else cell.ljust(width)
                for cell, width, column in zip(row, widths, self.columns, strict=True)
            ).rstrip()
            for row in zip_longest(*cells, fillvalue="")
        ]
        return "\n".join([self.title, lines[0], "-" * max(map(len, lines)), *lines[1:]] if lines else [self.title])

    def to_html(self) -> str:
        """For a page or a notebook."""
        head = "".join(f"<th>{escape(column.name)}</th>" for column in self.columns)
        rows = "".join(
            f"<tr>{''.join(f'<td>{escape(cell)}</td>' for cell in row)}</tr>"
            for row in zip(*(column.texts for column in self.columns), strict=True)
        )
        return f"<table><caption>{escape(self.title)}</caption><tr>{head}</tr>{rows}</table>"

    _repr_html_ = to_html  # the name by which a notebook asks for it


def columns_of_sweeps(specs: Sequence[SweepSpec]) -> tuple[Column, ...]:
    """Which sweeps these are."""
    return (
        Column("sweep", tuple(spec.id for spec in specs)),
        Column("axis", tuple(spec.axis for spec in specs)),
        Column("block", tuple(spec.block for spec in specs)),
        Column("pose, rad (m)", tuple(", ".join(f"{one:.3g}" for one in spec.pose) for spec in specs)),
    )


class Shown:
    """A result that prints as its tables and sentences, in a terminal and in a notebook.

    ``result["std"]`` is a column of its main table as an array, ``result.to_pandas()`` that table as a frame.
    """

    def shown(self) -> Sequence[Table | str]:
        """All that a person is to read, in order."""
        return (self.table(),)

    def table(self) -> Table:
        """The main table."""
        raise NotImplementedError

    def __getitem__(self, name: str) -> NDArray[Any]:
        return self.table()[name]

    def to_pandas(self) -> "pd.DataFrame":
        """The main table as a frame. ImportError without pandas, which sweepid does not require."""
        return self.table().to_pandas()

    def __str__(self) -> str:
        return "\n".join(str(part) for part in self.shown())

    def __repr__(self) -> str:
        return str(self)

    def to_html(self) -> str:
        """For a page or a notebook."""
        return "".join(f"<p>{escape(one)}</p>" if isinstance(one, str) else one.to_html() for one in self.shown())

    def _repr_html_(self) -> str:
        return self.to_html()
