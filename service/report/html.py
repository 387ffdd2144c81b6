"""A report, written as one HTML file, as PDF (both with figures as SVG), or as its tables alone.

On paper it has a first page, contents with page numbers, and numbered figures. WeasyPrint sets it, an optional
dependency that needs the system library Pango.
"""

import json
import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from html import escape, unescape
from importlib import import_module
from itertools import zip_longest
from pathlib import Path
from typing import Literal, Protocol, TypedDict, cast

from service import NoPdf
from service.report.drawing import DrawnFigure

Form = Literal["html", "pdf", "json"]


class _Set(Protocol):
    """A page that WeasyPrint has set."""

    def write_pdf(self) -> bytes: ...


class _Table(TypedDict):
    section: str
    head: list[str]
    rows: list[list[str]]


class ReportPage:
    """Collects title, body, figures and tables."""

    def __init__(self, title: str, lead: str = "") -> None:
        self._title = title
        self._parts: list[str | DrawnFigure] = [f"<h1>{escape(title)}</h1>"]
        if lead:
            self._parts.append(f'<p class="lead">{escape(lead)}</p>')
        self._tables: list[_Table] = []
        self._section = ["", ""]
        self._first = len(self._parts)  # number of parts before the contents of the PDF

    def add(self, *parts: str) -> None:
        """Add markup unchanged: escape text from other sources."""
        for part in parts:
            if part.startswith("<h2>"):
                self._section = [_plain(part), ""]
            elif part.startswith("<h3>"):
                self._section[1] = _plain(part)
            self._parts.append(part)

    def origin(self, facts: Iterable[tuple[str, str]]) -> None:
        """Origin of the data: the end of the first page, unless more is added to it."""
        self.add("<h2>Origin</h2>")
        self.facts_table(facts)
        self.first_page_ends()

    def first_page_ends(self) -> None:
        """The following parts come after the table of contents, if there is one, and belong to no section of it."""
        self._first = len(self._parts)
        self._section = ["", ""]

    def figure(self, figure: DrawnFigure) -> None:
        """Add a figure with the height of its layout."""
        self._parts.append(figure)

    def facts(self, facts: Iterable[tuple[str, str]]) -> None:
        """Add large values with their names below."""
        facts = list(facts)
        cells = "".join(f"<div><b>{escape(value)}</b><span>{escape(name)}</span></div>" for value, name in facts)
        self._parts.append(f'<div class="facts">{cells}</div>')
        self._tell_table(["", "value"], [(name, value) for value, name in facts])

    def facts_table(self, facts: Iterable[tuple[str, str]]) -> None:
        """Add names and values, which may be long."""
        facts = list(facts)
        rows = "".join(f"<tr><th>{escape(name)}</th><td>{escape(value)}</td></tr>" for name, value in facts)
        self._parts.append(f'<div class="card"><table class="properties"><tbody>{rows}</tbody></table></div>')
        self._tell_table(["", "value"], facts)

    def table(self, head: Iterable[str], rows: Iterable[Sequence[str]], first: str = "") -> None:
        """Add plain text in rows; `first`: CSS class of the first column."""
        head, rows = list(head), list(rows)
        top = "".join(f"<th>{escape(cell).replace('± ', '±&nbsp;')}</th>" for cell in head)
        cell = (f'<td class="{first}">', "<td>")
        body = "".join(
            f"<tr>{''.join(f'{cell[k > 0]}{escape(text)}</td>' for k, text in enumerate(row))}</tr>" for row in rows
        )
        table = f"<table><thead><tr>{top}</tr></thead><tbody>{body}</tbody></table>"
        self._parts.append(f'<div class="card scroll">{table}</div>')
        self._tell_table(head, rows)

    def written(self, form: Form) -> str | bytes:
        """The report in one of its forms; NoPdf if PDF is not available."""
        match form:
            case "html":
                return self.html()
            case "pdf":
                return self.pdf()
            case "json":
                return json.dumps({"title": self._title, "tables": self._tables}, indent=2, ensure_ascii=False)

    def html(self) -> str:
        """The file; nothing in it is loaded or run."""
        parts = [
            "<!doctype html>",
            '<html lang="en"><head><meta charset="utf-8">',
            '<meta name="viewport" content="width=device-width, initial-scale=1">',
            f"<title>{escape(self._title)}</title><style>{_style('screen')}</style></head><body><main>",
            *_Typesetting(paper=False).pieces(self._parts),
            "</main></body></html>",
        ]
        return "\n".join(parts)

    def paper_html(self) -> str:
        """As `html`, for paper; the table of contents is after the first page."""
        setting = _Typesetting(paper=True)
        first, rest = (list(setting.pieces(p)) for p in (self._parts[: self._first], self._parts[self._first :]))
        parts = [
            '<!doctype html><html lang="en"><head><meta charset="utf-8">',
            f"<title>{escape(self._title)}</title><style>{_style('paper')}</style></head><body>",
            *first,
            setting.contents(),
            *rest,
            "</body></html>",
        ]
        return "\n".join(parts)

    def pdf(self) -> bytes:
        """A4, with table of contents and numbered figures; NoPdf says what must be installed."""
        return _setter()(string=self.paper_html()).write_pdf()

    def _tell_table(self, head: Sequence[str], rows: Iterable[Sequence[str]]) -> None:
        section = ": ".join(part for part in self._section if part) or self._title
        self._tables.append({"section": section, "head": list(head), "rows": [list(row) for row in rows]})


def makes_pdf() -> bool:
    """Whether a PDF can be made here; takes a second at the first time."""
    try:
        _setter()
    except NoPdf:
        return False
    return True


def _setter() -> Callable[..., _Set]:
    try:
        return cast("Callable[..., _Set]", import_module("weasyprint").HTML)
    except (ImportError, OSError) as error:  # OSError: no Pango
        raise NoPdf(
            f"no PDF can be made here ({error}): install sweepid[pdf] and the system's Pango (Debian: "
            "libpango-1.0-0 libpangoft2-1.0-0 libharfbuzz-subset0 fonts-dejavu-core), or print the HTML"
        ) from None


def _plain(markup: str) -> str:
    return unescape(re.sub(r"<[^>]*>", "", markup))


def _style(sheet: str) -> str:
    return "\n" + (Path(__file__).parent / f"{sheet}.css").read_text("utf-8")


class _Typesetting:
    """Numbers figures and headings in order; figures are as wide as a page, or as A4 between its margins."""

    def __init__(self, *, paper: bool) -> None:
        self._paper = paper
        self._headings: list[tuple[str, str]] = []
        self._figures = 0
        self._section = self._part = ""

    def pieces(self, parts: Sequence[str | DrawnFigure]) -> Iterator[str]:
        for part, after in zip_longest(parts, parts[1:]):
            if not isinstance(part, str):
                yield self._figure(part)
            elif part.startswith("<p") and isinstance(after, dict):
                yield f'<div class="before">{part}</div>'  # keep with its figure
            else:
                yield self._markup(part)

    def contents(self) -> str:
        lines = (
            f'<p class="{level}"><a href="#section-{k}">{words}</a></p>'
            for k, (level, words) in enumerate(self._headings, start=1)
        )
        return f"<nav><h2>Contents</h2><div>{''.join(lines)}</div></nav>"

    def _markup(self, part: str) -> str:
        found = re.fullmatch(r"<(h[23])>(.*)</\1>", part, re.DOTALL)
        if found is None:
            return part
        level, words = found.groups()
        self._headings.append((level, words))
        if level == "h2":
            self._section, self._part = words, ""
        else:
            self._part = f": {words}"
        return f'<{level} id="section-{len(self._headings)}">{words}</{level}>'

    def _figure(self, figure: DrawnFigure) -> str:
        from service.report.plotting import PAPER_WIDTH, WIDTH, svg  # matplotlib

        self._figures += 1
        caption = f"Figure {self._figures}. {f'{self._section}{self._part}'.removeprefix(': ')}"
        drawn = svg(figure, unescape(caption), PAPER_WIDTH if self._paper else WIDTH)
        return f"<figure>{drawn}<figcaption>{caption}</figcaption></figure>"
