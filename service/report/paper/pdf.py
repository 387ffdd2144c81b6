"""HTML to PDF with WeasyPrint, an optional dependency that needs the system library Pango."""

from importlib import import_module
from typing import Protocol

from service.errors import SweepidError


class _Set(Protocol):
    def write_pdf(self) -> bytes: ...


class _Setter(Protocol):
    """The used part of WeasyPrint's `HTML`."""

    def __call__(self, *, string: str) -> _Set: ...


class NoPdf(SweepidError):
    """The libraries for PDF are not installed."""


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
