"""HTML to PDF by WeasyPrint, which is an extra: it needs Pango of the system."""

from importlib import import_module
from typing import Any

from service.errors import SweepidError


class NoPdf(SweepidError):
    """What sets PDF is not installed here."""


def pdf_of(html: str) -> bytes:
    """The PDF of a page that refers to nothing outside of itself; NoPdf tells what to install."""
    try:
        library: Any = import_module("weasyprint")  # only who wants PDF pays for it
    except (ImportError, OSError) as error:  # OSError: no Pango
        raise NoPdf(
            f"no PDF can be made here ({error}): install sweepid[pdf] and the system's Pango (Debian: "
            "libpango-1.0-0 libpangoft2-1.0-0 libharfbuzz-subset0 fonts-dejavu-core), or print the HTML"
        ) from None
    return bytes(library.HTML(string=html).write_pdf())
