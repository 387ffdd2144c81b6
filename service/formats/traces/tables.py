"""Tables in text, as loggers and controls write them: encoding, separators, heading and units are found by content.

The data are the longest run of lines that consist of numbers for the most part, with one number of cells. What stands
above them is the heading: key and value pairs, names, units, types. TwinCAT's Scope repeats the key before the value of
each channel (``Name<tab>M<tab>Name<tab>n``); its channels have a column of time each.
"""

import codecs
import csv
import io
import re
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from datetime import date
from functools import partial
from pathlib import Path
from typing import Any, cast

import numpy as np
import pyarrow as pa
import pyarrow.csv as pa_csv

from service import BadInput
from service.formats.traces.containers import ChannelName, ListedChannel, Taken, check_numbers, first_bytes, shown
from service.formats.traces.mapping import Csv
from service.formats.traces.units import known_unit, measures, unit_in
from service.model import Array
from service.store.files.columns import LARGEST_CSV, MOST_NUMBERS

_STAMP = re.compile(
    r"(?:(?:(\d{4})[-./](\d\d?)[-./](\d\d?)|(\d\d?)([./-])(\d\d?)[./-](\d{4}))[T ,]*)?"
    r"(\d\d?):(\d\d):(\d\d)(?:[.,:](\d{1,9}))?\s*([AaPp][Mm])?\s*(Z|[+-]\d\d:?\d\d)?"
)
_TIME_UNITS = (("s", 1.0), ("ms", 1e-3), ("us", 1e-6), ("ns", 1e-9))
_arrow, _csv = cast(Any, pa), cast(Any, pa_csv)  # without types
_MISSING = frozenset(("", "-", "--", "nan", "-nan", "nan(ind)", "-nan(ind)", "1.#qnan", "n/a", "#n/a", "null", "none"))
_SPELT = (str.upper, str.capitalize)
_TYPE = re.compile(r"(?i)(l?real|u?[sdl]?int|bool|byte|d?word|double|single|float|string|dt_\w+)\d*|-")


def timelike(cell: str) -> bool:
    """True for a stamp of a wall clock."""
    return _STAMP.fullmatch(cell.strip()) is not None


def _unwrapped(found: Array) -> Array:
    """Stamps of a wall clock in s from the first; midnight and the change to or from summer time are taken out."""
    steps = np.diff(found)
    for jump in (86400.0, 3600.0):
        for sign in (1, -1):
            steps[np.abs(steps - sign * jump) < min(600.0, jump / 2)] -= sign * jump
    return np.concatenate([[0.0], np.cumsum(steps)])


def _seconds(cell: str | None, place: str, row: int) -> float:
    found = _STAMP.fullmatch((cell or "").strip())
    if found is None:
        raise BadInput(place, f"row {row} is {cell!r}, which is no time of day")
    year, month, day, first, between, second, other, hour, minute, seconds, parts, half, _ = found.groups()
    days = 0
    try:
        if year:
            days = date(int(year), int(month), int(day)).toordinal()
        elif other:
            months = (int(first), int(second)) if between == "/" and int(first) <= 12 else (int(second), int(first))
            days = date(int(other), *months).toordinal()
    except ValueError as error:
        raise BadInput(place, f"row {row} is {cell!r}: {error}") from None
    hours = int(hour) % 12 + (12 if half.lower() == "pm" else 0) if half else int(hour)
    return days * 86400.0 + hours * 3600.0 + int(minute) * 60.0 + float(f"{seconds}.{parts or 0}")


def unit_of_time(time: Array, sample_rate: float | None) -> tuple[str, float]:
    """Unit of numbers without one, and its s: that of the sample rate, else the largest of a usable rate."""
    steps = np.diff(time)
    step = float(np.median(steps[steps > 0])) if (steps > 0).any() else 1.0
    for name, unit in _TIME_UNITS:
        rate = 1 / (step * unit)
        if sample_rate is not None and abs(rate / sample_rate - 1) < 0.1:
            return name, unit
    if sample_rate is not None:
        return "s", 1.0
    # Hz: slower records do not show an inertia, so that their numbers are of a smaller unit
    return next(((name, unit) for name, unit in _TIME_UNITS if 1 / (step * unit) >= 20.0), _TIME_UNITS[0])


def spacing(time: Array) -> float:
    """s between rows, by least squares; 1 where there is none."""
    rows = np.arange(len(time)) - (len(time) - 1) / 2
    power = float(rows @ rows)
    return float(rows @ time) / power if power and np.isfinite(time).all() else 1.0


def even(time: Array, columns: dict[str, Array], place: str) -> tuple[Array, dict[str, Array], tuple[str, ...]]:
    """The record on an even grid. Stamps that are rounded or doubled take the grid's; a record of uneven rate is
    interpolated. A gap stays, for a bundle to refuse.
    """
    steps = np.diff(time)
    if len(steps) < 2 or not np.isfinite(time).all() or not (steps >= 0).all():
        return time, columns, ()
    mean = spacing(time)
    grid = time[0] + mean * np.arange(len(time))
    usual = float(np.median(steps[steps > 0])) if (steps > 0).any() else 0.0
    off = float(np.abs(time - grid).max())
    if (steps == 0).any():
        if not mean > 0 or off > 2 * max(usual, mean):
            row = int(np.flatnonzero(steps == 0)[0])
            raise BadInput(place, f"time stands still at row {row + 2}: {time[row]:.6g} s")
        told = f"{int((steps == 0).sum())} stamps are doubled: the rows are taken as even, {1 / mean:.6g} Hz"
        return grid, columns, (told,)
    # part of the steps that may be off by 20 % in an even record
    gap = steps.max() > 1.5 * usual and (np.abs(steps - usual) > 0.2 * usual).mean() <= 0.05
    if gap or steps.max() > 5.0 * usual or off <= 0.4 * mean:  # times the common step: values were lost
        return time, columns, ()
    grid = time[0] + mean * np.arange(int((time[-1] - time[0]) / mean + 1e-9) + 1)
    told = f"steps of time are {steps.min():.3g} to {steps.max():.3g} s: interpolated to {1 / mean:.6g} Hz"
    return grid, {name: np.interp(grid, time, column) for name, column in columns.items()}, (told,)


def filled(column: Array) -> Array:
    """A column that has a value in each k-th row only, of a slower rate, with the rows between interpolated."""
    there = np.flatnonzero(np.isfinite(column))
    if len(there) < 3 or len(there) == len(column):
        return column
    apart = np.diff(there)
    if apart.min() < 2 or apart.min() != apart.max():
        return column
    return np.interp(np.arange(len(column)), there, column[there])


@dataclass(frozen=True, slots=True)
class _Head:
    names: tuple[str, ...]  # by column; "" for a channel's own time
    units: tuple[str, ...]
    clocks: dict[int, int]  # column of time by column of values
    intervals: dict[int, float]  # s, by column of values


class TextTable:
    """One table, whose data stay in the file until a sweep is read. BadInput if the file has none, or is too large."""

    def __init__(self, path: Path, form: Csv) -> None:
        self._path, self._place = path, str(path)
        self._encoding, self._lines = _measured(path)
        plain = self._encoding in ("utf-8", "utf-8-sig")
        self.notes = () if plain else (f"{path.name} is read as {self._encoding}",)
        with _text(path, self._encoding) as text:
            lines = text.read(2**18).split("\n")  # characters in which the form is found
            if text.read(1):
                lines.pop()
        self._odd: list[tuple[int, int, str]] = []  # lines of another number of cells
        self._delimiter, self._point, self._first = _form(lines, form, self._place)
        cells = partial(_cells, delimiter=self._delimiter)
        self._width = len(cells(lines[self._first]))
        heading = [cells(line) for line in lines[form.skip_rows : self._first]]
        self._head = _head(heading, self._width)
        self._interval = _stated_interval(lines[form.skip_rows : self._first])
        self._sample = cells(lines[self._first])
        times, names = set(self._head.clocks.values()), self._head.names
        self._numbered = tuple(f"{name} (column {k})" for k, name in enumerate(names, start=1))
        self.listed = tuple(
            ListedChannel(name=name if names.count(name) == 1 else self._numbered[k], unit=self._head.units[k])
            for k, name in enumerate(names)
            if k not in times and name
        )

    def read(self, channels: Sequence[ChannelName]) -> Taken:
        """The columns; the clock is that of a channel's own time, or the interval in the heading."""
        found = [self._index(channel.source) for channel in channels]
        times = [self._head.clocks.get(k) for k in found]
        wanted = tuple(dict.fromkeys((*found, *(k for k in times if k is not None))))
        rows = self._columns(wanted)
        units = tuple(self._head.units[k] for k in found)
        clocks = [
            None if at is None else self._scaled(rows[wanted.index(at)], k) for k, at in zip(found, times, strict=True)
        ]
        if any(clock is not None for clock in clocks):
            return _on_one_clock([rows[wanted.index(k)] for k in found], clocks, units, self.notes, self._place)
        values = rows if len(rows) == len(found) else rows[[wanted.index(k) for k in found]]
        clock = None if self._interval is None else np.arange(values.shape[1], dtype=np.float64) * self._interval
        return Taken(values, units, clock, self.notes)

    def _scaled(self, time: Array, column: int) -> Array:
        """s; TwinCAT writes ms, or a count of samples, and states the interval."""
        step = float(np.nanmedian(np.diff(time))) if np.isfinite(time).sum() > 1 else 1.0
        stated, unit = self._head.intervals.get(column), measures(self._head.units[self._head.clocks[column]])
        if stated is not None and step > 0:
            return time * (stated / step)
        if unit is not None and unit[0] == "time":
            return time * unit[1]
        return time * unit_of_time(time[np.isfinite(time)], None)[1]

    def _index(self, source: str) -> int:
        """Of a column by its name, with its unit or its number too; else whatever the case of letters."""
        wanted, names = source.strip(), self._head.names
        full = [f"{name} [{unit}]" if unit else name for name, unit in zip(names, self._head.units, strict=True)]
        folded = [name.casefold() for name in names]
        for candidates in (names, self._numbered, full, folded):
            given = wanted.casefold() if candidates is folded else wanted
            found = [k for k, name in enumerate(candidates) if name == given]
            if len(found) == 1:
                return found[0]
            if len(found) > 1:
                told = " or ".join(repr(self._numbered[k]) for k in found)
                raise BadInput(self._place, f"column {source!r} occurs twice: name it as {told}")
        there = shown([name for name in names if name])
        raise BadInput(self._place, f"column {source!r} is missing; there are {there}")

    def _columns(self, wanted: tuple[int, ...]) -> Array:
        """(columns, n); a missing value is NaN."""
        check_numbers(self._lines, len(wanted), MOST_NUMBERS, self._place)
        stamps = {k for k in wanted if k < len(self._sample) and timelike(self._sample[k])}
        rows, end = np.empty((len(wanted), self._lines)), 0
        try:
            for batch in self._parsed(wanted, stamps):
                start, end = end, end + batch.num_rows
                for k, row, column in zip(wanted, rows, batch.columns, strict=True):
                    if k in stamps:
                        place, cells = f"{self._place} column {self._head.names[k]!r}", column.to_pylist()
                        row[start:end] = [_seconds(cell, place, n) for n, cell in enumerate(cells, start + 1)]
                    else:  # without a null Arrow converts nothing, for which it would reserve 1 GiB
                        row[start:end] = column.fill_null(np.nan).to_numpy(zero_copy_only=False)
        except _arrow.ArrowInvalid as error:
            self._tell_text(wanted, stamps)
            raise BadInput(self._place, f"cannot be read: {' '.join(str(error).split())}") from None
        for line, cells, text in self._odd:
            told = f"has {cells} cells, the lines before have {self._width}: {text[:60]!r}"
            raise BadInput(f"{self._place} line {line}", told)
        for k, row in zip(wanted, rows, strict=True):
            if k in stamps and end:
                row[:end] = _unwrapped(row[:end])
        return rows[:, :end]

    def _parsed(self, wanted: tuple[int, ...], text: set[int]) -> Iterator[Any]:
        """The wanted columns by batches of rows; those of `text` as text; blanks that separate become tabs.

        Each piece is parsed whole: a thread of Arrow's streaming reader reads ahead, and crashes if that ends early.
        """
        blanks = self._delimiter == " "
        read = _csv.ReadOptions(column_names=[str(k) for k in range(self._width)], use_threads=False)
        convert = _csv.ConvertOptions(
            decimal_point=self._point,
            include_columns=[str(k) for k in wanted],
            column_types={str(k): _arrow.string() if k in text else _arrow.float64() for k in wanted},
            null_values=sorted({*_MISSING, *(form(one) for one in _MISSING for form in _SPELT), "NaN", "None"}),
            strings_can_be_null=True,
        )
        with _text(self._path, self._encoding) as file:
            for _ in range(self._first):
                file.readline()
            before = self._first
            while lines := file.readlines(2**18):  # characters at once
                body = "".join(lines)
                if blanks:
                    body = re.sub(r"[ \t]+", "\t", re.sub(r"(?m)^[ \t]+|[ \t]+$", "", body))
                parse = _csv.ParseOptions(
                    delimiter="\t" if blanks else self._delimiter, invalid_row_handler=partial(self._odd_row, before)
                )
                before += len(lines)
                if body.strip("\n"):
                    data = _arrow.BufferReader(body.encode())
                    yield from _csv.read_csv(data, read, parse, convert).to_batches()

    def _odd_row(self, before: int, row: Any) -> str:
        """A line with another number of cells, as ``EOF``, is passed over if it holds no number."""
        if any(_is_number(cell, self._point) for cell in _cells(row.text, self._delimiter)):
            self._odd.append((before + (row.number or 0), row.actual_columns, row.text))
        return "skip"

    def _tell_text(self, wanted: tuple[int, ...], stamps: set[int]) -> None:
        """BadInput with line and column of the first cell that is no number."""
        row = 0
        with suppress(_arrow.ArrowInvalid):  # what is wrong is not in a cell
            for batch in self._parsed(wanted, set(wanted)):
                for k, column in zip(wanted, batch.columns, strict=True):
                    for n, cell in enumerate(() if k in stamps else column.to_pylist(), row + self._first + 1):
                        if cell is not None and not _is_number(cell.strip(), self._point):
                            name = self._head.names[k]
                            raise BadInput(f"{self._place} line {n}, column {name!r}", f"{cell[:40]!r} is not a number")
                row += batch.num_rows


def _text(path: Path, encoding: str) -> io.TextIOWrapper:
    return path.open(encoding=encoding, errors="replace" if encoding == "cp1252" else "strict")


def _measured(path: Path) -> tuple[str, int]:
    """Encoding, by byte order mark, NUL bytes of UTF-16, else UTF-8, else the Windows code page 1252; lines."""
    boms = (
        (codecs.BOM_UTF8, "utf-8-sig"), (codecs.BOM_UTF32_LE, "utf-32"), (codecs.BOM_UTF32_BE, "utf-32"),
        (codecs.BOM_UTF16_LE, "utf-16"), (codecs.BOM_UTF16_BE, "utf-16"),
    )  # fmt: skip
    head, size = first_bytes(path, 4096), path.stat().st_size
    if size > LARGEST_CSV:
        raise BadInput(str(path), f"is {size} bytes large, limit {LARGEST_CSV} bytes")
    encoding = next((name for mark, name in boms if head.startswith(mark)), "utf-8")
    if encoding == "utf-8" and b"\0" in head:
        odd, even = head[1::2].count(0), head[::2].count(0)
        encoding = "utf-16-le" if odd > even else "utf-16-be"
        if max(odd, even) < len(head) // 4 or min(odd, even) > max(odd, even) // 8:
            raise BadInput(str(path), f"is not a trace that is known: it begins with {head[:8]!r}")
    for tried in (encoding, "cp1252"):
        try:
            with _text(path, tried) as text:
                return tried, 1 + sum(part.count("\n") for part in iter(partial(text.read, 2**18), ""))
        except UnicodeDecodeError as error:
            if encoding != "utf-8":
                raise BadInput(str(path), f"cannot be read as {encoding}: {error}") from None
    raise AssertionError(path)  # code page 1252 reads all


def _on_one_clock(
    values: Sequence[Array], clocks: Sequence[Array | None], units: tuple[str, ...], notes: tuple[str, ...], place: str
) -> Taken:
    """Channels with clocks of their own, interpolated to the finest of them if they differ."""
    first = next(clock for clock in clocks if clock is not None)
    kept: list[tuple[Array, Array]] = []
    for value, clock in zip(values, (first if clock is None else clock for clock in clocks), strict=True):
        there = np.isfinite(clock) & np.isfinite(value)
        if there.sum() < 2 or not (np.diff(clock[there]) > 0).all():
            raise BadInput(place, f"a channel has {there.sum()} values, or its time does not increase")
        kept.append((value[there], clock[there]))
    finest = max((clock for _, clock in kept), key=len)
    if all(len(clock) == len(finest) and np.allclose(clock, finest, rtol=0, atol=1e-9) for _, clock in kept):
        return Taken(np.array([value for value, _ in kept]), units, finest, notes)
    start, end = max(clock[0] for _, clock in kept), min(clock[-1] for _, clock in kept)
    common = finest[(finest >= start) & (finest <= end)]
    if len(common) < 2:
        raise BadInput(place, "its channels have no time in common")
    told = "channels have clocks of their own; all are interpolated to the finest"
    return Taken(np.array([np.interp(common, clock, value) for value, clock in kept]), units, common, (*notes, told))


def _cells(line: str, delimiter: str) -> list[str]:
    line = line.rstrip("\n")
    if delimiter == " ":
        return line.split()
    if '"' in line:
        return [cell.strip() for row in csv.reader([line], delimiter=delimiter) for cell in row]
    return [cell.strip() for cell in line.split(delimiter)]


def _is_number(cell: str, point: str) -> bool:
    if cell.casefold() in _MISSING or "_" in cell or (point == "," and "." in cell):
        return cell.casefold() in _MISSING and cell != ""
    try:
        float(cell.replace(point, "."))
    except ValueError:
        return False
    return True


def _form(lines: Sequence[str], form: Csv, place: str) -> tuple[str, str, int]:
    """Delimiter, decimal point and first line of the data."""
    best: tuple[int, str, str, int] = (0, "", "", 0)
    for delimiter, point in ("\t.", ";.", ",.", "|.", "\t,", ";,", "|,", " .", " ,"):
        if form.delimiter not in (None, delimiter) or form.decimal_point not in (None, point):
            continue
        numbers = partial(_is_number, point=point)
        score, first = _longest(lines, form.skip_rows, delimiter, numbers)
        if score > best[0]:
            best = (score, delimiter, point, first)
    if best[0] == 0:
        begun = next((line for line in lines if line.strip()), "")[:60]
        raise BadInput(place, f"has no table of numbers; it begins with {begun!r}")
    return best[1:]


def _longest(lines: Sequence[str], skip: int, delimiter: str, is_number: Callable[[str], bool]) -> tuple[int, int]:
    """Numbers in the longest run of lines of data, and where it starts."""
    best, score, start, width, count = (0, 0), 0, 0, 0, 0
    firm = 10  # lines after which another kind of line is a fault in the data, and not their end
    for k, line in enumerate(lines):
        cells = _cells(line, delimiter) if k >= skip and line.strip() and not line.startswith("#") else []
        numbers = sum(map(is_number, cells)) if len(cells) > 1 else 0
        stamps = sum(timelike(cell) for cell in cells) if 2 * numbers <= len(cells) else 0
        filled = sum(cell != "" for cell in cells)
        if numbers and 2 * (numbers + stamps) > filled and numbers + stamps > 1 and (2 * numbers > filled or stamps):
            if len(cells) != width and count < firm:
                score, start, width, count = 0, k, len(cells), 0
            if len(cells) == width:
                score, count = score + numbers + stamps, count + 1
            if count > 1 and score > best[0]:
                best = (score, start)
        elif line.strip() and count < firm:
            score, width, count = 0, 0, 0
    return best


def _head(rows: Sequence[list[str]], width: int) -> _Head:
    rows = [[row[0].lstrip("#%; ").strip(), *row[1:]] for row in rows if row]
    rows = [row[1:] if len(row) == width + 1 and not row[0] else row for row in rows]
    keyed = {row[0].casefold(): row for row in rows if len(row) >= width > 1 and row[0] and _repeats(row, width)}
    if known := keyed.get("name") or keyed.get("symbolname"):
        return _scope(keyed, known, width)
    fitting = [row for row in rows if abs(len(row) - width) <= 1 and sum(map(bool, row)) > width // 2]
    fitting = [row[:width] + [""] * (width - len(row)) for row in fitting]
    units = next((row for row in fitting if _are_units(row)), None)

    def names(row: list[str]) -> bool:
        values = width > 1 and all(_is_number(cell, ".") for cell in row[1:])  # as "# Scale: 1;2"
        return row is not units and not values and not all(_TYPE.fullmatch(cell) for cell in row if cell)

    unnamed = [f"column {k + 1}" for k in range(width)]
    found = max(filter(names, fitting), key=lambda row: len({cell for cell in row if cell}), default=unnamed)
    parts = [unit_in(cell) for cell in found]
    stated = units or [""] * width
    heads = [(name, unit or stated[k].strip("[]() ")) for k, (name, unit) in enumerate(parts)]
    return _pairs(_Head(tuple(name for name, _ in heads), tuple(unit for _, unit in heads), {}, {}))


def _pairs(head: _Head) -> _Head:
    """A name that stands for time before each other column makes these the channels' own times."""
    times = [k for k, name in enumerate(head.names[:-1]) if head.names.count(name) > 1 and k % 2 == 0]
    if len(times) < 2 or len({head.names[k] for k in times}) > 1:
        return head
    names = tuple("" if k in times else name for k, name in enumerate(head.names))
    return _Head(names, head.units, {k + 1: k for k in times}, {})


def _repeats(row: list[str], width: int) -> bool:
    """Its first cell is that of all channels' first columns."""
    starts = [k for k in range(width) if row[k] == row[0]]
    return len(starts) > 1 or row[0].casefold() in ("name", "symbolname", "unit", "data-type", "sampletime[ms]")


def _scope(keyed: dict[str, list[str]], names: list[str], width: int) -> _Head:
    """The heading of TwinCAT's Scope: groups of a column of time and those of its channels."""
    times = [k for k in range(width) if names[k].casefold() == names[0].casefold()]
    clocks = {k: max(t for t in times if t < k) for k in range(width) if k not in times}
    units = keyed.get("unit", [""] * width)
    sample = keyed.get("sampletime[ms]", [])
    steps: dict[int, float] = {}
    for k in clocks:
        if k < len(sample) and (step := sample[k].replace(",", ".")).replace(".", "", 1).isdigit() and float(step) > 0:
            steps[k] = float(step) * 1e-3
    parts = [("", "") if k in times else unit_in(names[k]) for k in range(width)]
    of_values = ["" if k in times or k >= len(units) else units[k].strip("[]() ") for k in range(width)]
    stated = tuple(unit or other for (_, unit), other in zip(parts, of_values, strict=True))
    named = tuple(name for name, _ in parts)
    return _Head(named, tuple("" if unit in ("None", "-") else unit for unit in stated), clocks, steps)


def _are_units(row: Sequence[str]) -> bool:
    filled = [cell.strip("[]() ") for cell in row if cell and cell != "-"]
    return bool(filled) and 2 * sum(known_unit(cell) is not None for cell in filled) > len(filled)


def _stated_interval(lines: Sequence[str]) -> float | None:
    """s, of the heading's interval or rate of sampling."""
    rate = re.compile(
        r"(?i)(?:sampl\w*[ _-]?(?:rate|freq\w*)|abtast(?:rate|frequenz))\W*?(?:\[?k?hz\]?)?"
        r"[\s:=;,\t]+([\d.,]+)\s*(k?)hz?"
    )
    interval = re.compile(
        r"(?i)(?:sampl\w*[ _-]?(?:time|period|interval)|abtast(?:zeit|intervall|periode)|cycle[ _-]?time|zykluszeit"
        r"|interval|dt)"
        r"\W*?(?:[\[(]?(ms|us|µs|ns|s)[\])]?)?(?:\s+is)?[\s:=;,\t]+([\d.,]+(?:e-?\d+)?)\s*(n?sec|ms|us|µs|ns|s)?\b"
    )
    for line in lines:
        if found := interval.search(line):
            unit = (found[3] or found[1] or "s").lower().replace("sec", "s").replace("µ", "u")
            return float(found[2].replace(",", ".").rstrip(".")) * {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}[unit]
        if found := rate.search(line):
            return 1 / (float(found[1].replace(",", ".").rstrip(".")) * (1e3 if found[2] else 1.0))
    return None
