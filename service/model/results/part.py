"""The base of all models of results, with their digits and tables."""

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from html import escape
from itertools import zip_longest
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Self, cast

import numpy as np
from numpy.typing import NDArray
from pydantic import (
    BaseModel,
    BeforeValidator,
    ConfigDict,
    GetJsonSchemaHandler,
    JsonValue,
    PlainSerializer,
    TypeAdapter,
    ValidationError,
    WithJsonSchema,
)
from pydantic.json_schema import JsonSchemaValue
from pydantic_core import CoreSchema

from service import BadInput
from service.model.recording import SweepSpec

if TYPE_CHECKING:
    import pandas as pd


class Part(BaseModel):
    """A part of a result. Keys without a field are kept; a field with a default is missing in older results."""

    model_config = ConfigDict(frozen=True, extra="allow")

    def as_json(self) -> dict[str, JsonValue]:
        """The fields that were read or set; missing keys stay missing."""
        return self.model_dump(mode="json", exclude_unset=True)

    def to_json(self, path: Path | str | None = None) -> str:
        """The JSON that the commands write, indented; also into a file. OSError where that cannot be written."""
        text = json.dumps(self.as_json(), indent=2, allow_nan=False)
        if path is not None:
            Path(path).write_bytes(f"{text}\n".encode())
        return text

    def with_nonempty(self, **fields: object) -> Self:
        """A copy with the fields that are not empty; an empty one stays missing in the JSON."""
        return self.model_copy(update={name: value for name, value in fields.items() if value})


Unbounded = Annotated[  # a number, or infinite: null in JSON
    float,
    BeforeValidator(lambda value: math.inf if value is None else value),
    PlainSerializer(lambda value: value if math.isfinite(value) else None, when_used="json"),
    WithJsonSchema({"anyOf": [{"type": "number"}, {"type": "null"}]}),
]


class Document(Part):
    """A complete result as it is stored or written to a file.

    `VERSION` is the newest readable version. Documents without the key "version" have version 1; fields missing in old
    ones have a default in the model.
    """

    VERSION: ClassVar[int] = 1

    @classmethod
    def read(cls, document: object, place: str) -> Self:
        """From JSON. BadInput names place and field, also if a newer version wrote the document."""
        if isinstance(document, Mapping):
            version = cast("Mapping[str, object]", document).get("version", 1)
            if not isinstance(version, int) or not 1 <= version <= cls.VERSION:
                raise BadInput(
                    f"{place}.version",
                    f"{version!r} is newer than {cls.VERSION}, the newest that can be read: update sweepid",
                )
        try:
            return cls.model_validate(document)
        except ValidationError as error:
            first = error.errors(include_url=False)[0]
            where = ".".join(str(key) for key in (place, *first["loc"]))
            given = repr(first["input"])
            got = "" if len(given) > 60 or first["type"] == "missing" else f", got {given}"
            more = f" (and {error.error_count() - 1} more)" if error.error_count() > 1 else ""
            raise BadInput(where, f"{first['msg']}{got}{more}; use a file written by this version of sweepid") from None


@dataclass(frozen=True)
class JsonOf:
    """Annotates a JSON object: its schema is that of a model (or a union of models), its content is not validated."""

    model: Any  # whatever a TypeAdapter takes

    def __get_pydantic_json_schema__(self, _: CoreSchema, handler: GetJsonSchemaHandler) -> JsonSchemaValue:
        return handler(TypeAdapter(self.model).core_schema)


def with_std(value: float, std: float | None, sign: str = "") -> tuple[str, str]:
    """Value and standard deviation as a person reads them: ``("253.2", "9.5")``, ``("12350", "120")``.

    The value is rounded to the digit of the standard deviation's second significant digit (JCGM 100:2008, 7.2.6), so a
    value far below it is 0. Without a standard deviation it has five digits, and the second text is a dash. `sign`: "+"
    for a difference.
    """
    if std is None or not (0 < std < math.inf and math.isfinite(value)):
        return f"{value:{sign}.5g}", "–"
    decimals = 1 - int(f"{std:.1e}".partition("e")[2])
    if decimals > 7 or abs(value) >= 1e7:
        digits = max(0, decimals + int(f"{value:e}".partition("e")[2]))
        return f"{value:{sign}.{digits}e}", f"{std:.1e}"
    shown = max(decimals, 0)
    return f"{round(value, decimals) + 0.0:{sign}.{shown}f}", f"{round(std, decimals):.{shown}f}"


def two_digits(value: float) -> str:
    """A confidence, or another standard deviation in percent: ``"0.42"``, ``"12"``, ``"130"``."""
    return f"{float(f'{value:.2g}'):.7g}"


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
