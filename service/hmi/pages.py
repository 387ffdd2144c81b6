"""The operator's pages: static files, and the plotting script of the installed `plotly` package."""

from collections.abc import Callable, Coroutine
from importlib.resources import files
from pathlib import Path

from fastapi import FastAPI
from fastapi.responses import FileResponse

_SCRIPTS = (
    "api",
    "app",
    "axes",
    "diagnosis",
    "elements",
    "experiment",
    "figures",
    "findings",
    "intent",
    "machine",
    "motion",
    "refresh",
)
_STATIC = Path(__file__).parent / "static"
_HEADERS = {
    # nothing is loaded from elsewhere, no inline script runs; plotly writes style attributes
    "Content-Security-Policy": (
        "default-src 'none'; script-src 'self'; style-src 'self' 'unsafe-inline'; img-src 'self' data:; "
        "connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
    ),
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cache-Control": "no-cache",
}


def add_pages(app: FastAPI) -> None:
    """``/``, ``/diagnosis`` and the files that they load."""
    plotly = Path(str(files("plotly").joinpath("package_data", "plotly.min.js")))
    pages = {
        "/": _STATIC / "index.html",
        "/diagnosis": _STATIC / "diagnosis.html",
        **{f"/{name}.js": _STATIC / f"{name}.js" for name in _SCRIPTS},
        "/style.css": _STATIC / "style.css",
        "/plotly.min.js": plotly,
    }
    for url, path in pages.items():
        app.add_api_route(url, _page(path), response_class=FileResponse, include_in_schema=False)


def _page(path: Path) -> Callable[[], Coroutine[None, None, FileResponse]]:
    async def page() -> FileResponse:
        return FileResponse(path, headers=_HEADERS)

    return page
