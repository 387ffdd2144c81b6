"""A report, written as one HTML file, as PDF (both with figures as SVG), or as its tables alone."""

import json
import re
from collections.abc import Iterable, Sequence
from html import escape, unescape
from typing import Literal, TypedDict

from service.report.drawing import Figure

Form = Literal["html", "pdf", "json"]

_STYLE = """
:root { color-scheme: light; }
body { font: 16px/1.55 system-ui, sans-serif; color: #0f172a; background: #f8fafc; margin: 0; }
main { max-width: 1060px; margin: 0 auto; padding: 40px 28px 80px; }
h1 { font-size: 30px; line-height: 1.2; margin: 0 0 6px; letter-spacing: -0.01em; }
h2 { font-size: 21px; margin: 48px 0 6px; letter-spacing: -0.005em; }
h3 { font-size: 16px; margin: 22px 0 4px; }
p { margin: 6px 0 12px; color: #334155; max-width: 78ch; }
p.lead { color: #475569; margin-bottom: 24px; }
p.verdict { font-size: 17px; color: #0f172a; margin: 0; }
.card { background: white; border: 1px solid #e2e8f0; border-radius: 10px; padding: 14px 18px; margin: 14px 0; }
.card.settled { border-left: 6px solid #15803d; }
.card.open { border-left: 6px solid #b45309; }
.card.unexplained { border-left: 6px solid #be123c; }
.facts { display: grid; grid-template-columns: repeat(auto-fit, minmax(170px, 1fr)); gap: 12px; margin: 20px 0; }
.facts div { background: white; border: 1px solid #e2e8f0; border-radius: 10px; padding: 12px 16px; }
.facts b { display: block; font-size: 24px; font-weight: 600; line-height: 1.3; }
.facts span { color: #64748b; font-size: 13.5px; }
.scroll { overflow-x: auto; }
table { border-collapse: collapse; width: 100%; font-variant-numeric: tabular-nums; }
th, td { padding: 7px 12px; text-align: right; border-bottom: 1px solid #e2e8f0; white-space: nowrap; }
th:first-child, td:first-child { text-align: left; white-space: normal; }
thead th { color: #475569; font-weight: 600; border-bottom: 2px solid #cbd5e1; }
tbody tr:last-child :is(td, th) { border-bottom: 0; }
table.properties th { color: #475569; font-weight: 600; width: 11em; vertical-align: top; }
table.properties td { text-align: left; white-space: normal; overflow-wrap: anywhere; }
td.name { font-size: 14px; max-width: 560px; overflow-wrap: anywhere; }
.note { color: #64748b; font-size: 14px; }
figure { background: white; border: 1px solid #e2e8f0; border-radius: 10px; padding: 14px 18px; margin: 14px 0; }
figure svg { display: block; width: 100%; height: auto; }
figcaption { color: #64748b; font-size: 13.5px; margin-top: 6px; }
@page {
  size: A4;
  margin: 15mm 15mm 18mm;
  @bottom-right { content: counter(page) " / " counter(pages); font: 9pt sans-serif; }
}
@media print {
  body { background: white; font-size: 10pt; }
  main { max-width: none; padding: 0; }
  h1 { font-size: 18pt; }
  h2 { font-size: 13pt; margin-top: 20px; }
  h3 { font-size: 11pt; }
  h2, h3, p:has(+ .card) { break-after: avoid; }
  p { max-width: none; orphans: 3; widows: 3; }
  .card, .facts div { break-inside: avoid; border-color: #94a3b8; }
  .card { padding: 8px 10px; margin: 8px 0; }
  figure { padding: 0; border: 0; break-inside: avoid; }
  .facts { grid-template-columns: repeat(5, 1fr); gap: 6px; margin: 10px 0; }
  .facts div { padding: 6px 8px; }
  .facts b { font-size: 14pt; }
  .facts span, .note, td.name, table.properties { font-size: 9pt; }
  .scroll { overflow: visible; }
  .scroll:has(tr:nth-child(12)) { break-inside: auto; }
  thead { display: table-header-group; }
  tr { break-inside: avoid; }
  th, td { padding: 3px 6px; white-space: normal; overflow-wrap: break-word; }
}
"""


class _Table(TypedDict):
    section: str
    head: list[str]
    rows: list[list[str]]


class Page:
    """Collects title, body, figures and tables."""

    def __init__(self, title: str, lead: str = "") -> None:
        self._title = title
        self._parts: list[str | Figure] = [f"<h1>{escape(title)}</h1>"]
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

    def figure(self, figure: Figure) -> None:
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
        body = "".join(
            f'<tr><td class="{first}">{escape(row[0])}</td>'
            + "".join(f"<td>{escape(cell)}</td>" for cell in row[1:])
            + "</tr>"
            for row in rows
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
        from service.report.paper import Setting  # draws figures
        from service.report.plotting import WIDTH

        return "\n".join(
            (
                "<!doctype html>",
                '<html lang="en"><head><meta charset="utf-8">',
                '<meta name="viewport" content="width=device-width, initial-scale=1">',
                f"<title>{escape(self._title)}</title><style>{_STYLE}</style></head><body><main>",
                *Setting(WIDTH).pieces(self._parts),
                "</main></body></html>",
            )
        )

    def pdf(self) -> bytes:
        """A4, with table of contents and numbered figures; NoPdf if PDF is not available."""
        from service.report.paper import paper_html, pdf_of

        return pdf_of(paper_html(self._title, self._parts[: self._first], self._parts[self._first :]))

    def _tell_table(self, head: Sequence[str], rows: Iterable[Sequence[str]]) -> None:
        section = ": ".join(part for part in self._section if part) or self._title
        self._tables.append({"section": section, "head": list(head), "rows": [list(row) for row in rows]})


def _plain(markup: str) -> str:
    return unescape(re.sub(r"<[^>]*>", "", markup))
