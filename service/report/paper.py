"""A report for paper: first page, contents with page numbers, numbered figures.

WeasyPrint sets it, an optional dependency that needs the system library Pango.
"""

import re
from collections.abc import Iterator, Sequence
from html import escape, unescape
from importlib import import_module
from itertools import zip_longest
from typing import Protocol

from service.model.errors import NoPdf
from service.report.drawing import Figure
from service.report.plotting import PAPER, svg

STYLE = """
@page {
  size: A4;
  margin: 16mm 15mm 18mm;
  @bottom-left { content: string(title); font: 8pt sans-serif; color: #475569; }
  @bottom-right { content: counter(page) " / " counter(pages); font: 8pt sans-serif; color: #475569; }
}
body { font: 9.5pt/1.4 sans-serif; color: #0f172a; margin: 0; }
h1 { font-size: 18pt; line-height: 1.2; margin: 0 0 4pt; string-set: title content(); bookmark-level: 1; }
h2 { font-size: 13pt; margin: 16pt 0 4pt; }
h3 { font-size: 10.5pt; margin: 10pt 0 3pt; }
h2, h3, h2 + p, h3 + p { break-after: avoid; }
p { margin: 4pt 0 6pt; orphans: 3; widows: 3; }
p.lead { color: #475569; font-size: 10.5pt; }
p.verdict { font-size: 11.5pt; margin: 0; }
.card { margin: 6pt 0; }
.card.settled, .card.open, .card.unexplained {
  border: 1px solid #94a3b8; border-left-width: 5px; padding: 7pt 9pt;
}
.card.settled { border-left-color: #15803d; }
.card.open { border-left-color: #b45309; }
.card.unexplained { border-left-color: #be123c; }
.facts { margin: 8pt 0; }
.facts div { display: inline-block; width: 31%; margin: 0 1.5% 6pt 0; vertical-align: top; }
.facts b { display: block; font-size: 13pt; }
.facts span, .note { color: #475569; font-size: 8pt; }
table { border-collapse: collapse; width: 100%; font-size: 8.5pt; }
th, td { padding: 2.5pt 4pt; text-align: right; border-bottom: 0.5pt solid #cbd5e1; }
th:first-child, td:first-child { text-align: left; }
td:first-child, table.properties td { overflow-wrap: anywhere; }
thead th { color: #475569; border-bottom: 1pt solid #64748b; }
tr { break-inside: avoid; }
table.properties th { color: #475569; width: 9em; vertical-align: top; }
table.properties td { text-align: left; }
td.name { width: 50%; }
figure { margin: 4pt 0 8pt; break-inside: avoid; }
figure svg { display: block; width: 100%; height: auto; }
figcaption { font-size: 8.5pt; color: #475569; margin-top: 2pt; }
nav { break-after: page; }
nav div { columns: 2; column-gap: 10mm; }
.before { break-after: avoid; }
nav p { margin: 1.5pt 0; }
nav a { color: inherit; text-decoration: none; display: block; }
nav a::after { content: leader(".") target-counter(attr(href), page); }
nav .h3 { margin-left: 14pt; }
"""

_HEADING = re.compile(r"<(h[23])>(.*)</\1>", re.DOTALL)


def paper_html(title: str, first: Sequence[str | Figure], parts: Sequence[str | Figure]) -> str:
    """Markup and figures in order; the table of contents is between `first` and the rest."""
    setting = Setting(PAPER)
    body = [*setting.pieces(first), ""]
    rest = list(setting.pieces(parts))
    body[-1] = setting.contents()
    return "\n".join(
        (
            '<!doctype html><html lang="en"><head><meta charset="utf-8">',
            f"<title>{escape(title)}</title><style>{STYLE}</style></head><body>",
            *body,
            *rest,
            "</body></html>",
        )
    )


class Setting:
    """Numbers figures and headings in order; figures are `width` px wide."""

    def __init__(self, width: float) -> None:
        self._width = width
        self._headings: list[tuple[str, str]] = []
        self._figures = 0
        self._section = self._part = ""

    def pieces(self, parts: Sequence[str | Figure]) -> Iterator[str]:
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
        found = _HEADING.fullmatch(part)
        if found is None:
            return part
        level, words = found.groups()
        self._headings.append((level, words))
        if level == "h2":
            self._section, self._part = words, ""
        else:
            self._part = f": {words}"
        return f'<{level} id="section-{len(self._headings)}">{words}</{level}>'

    def _figure(self, figure: Figure) -> str:
        self._figures += 1
        caption = f"Figure {self._figures}. {self._section}{self._part}"
        return f"<figure>{svg(figure, unescape(caption), self._width)}<figcaption>{caption}</figcaption></figure>"


class _Set(Protocol):
    def write_pdf(self) -> bytes: ...


class _Setter(Protocol):
    """The used part of WeasyPrint's `HTML`."""

    def __call__(self, *, string: str) -> _Set: ...


def pdf_of(html: str) -> bytes:
    """The PDF of a page without external references; NoPdf says what must be installed."""
    try:
        setter: _Setter = import_module("weasyprint").HTML  # only imported for PDF
    except (ImportError, OSError) as error:  # OSError: no Pango
        raise NoPdf(
            f"no PDF can be made here ({error}): install sweepid[pdf] and the system's Pango (Debian: "
            "libpango-1.0-0 libpangoft2-1.0-0 libharfbuzz-subset0 fonts-dejavu-core), or print the HTML"
        ) from None
    return setter(string=html).write_pdf()
