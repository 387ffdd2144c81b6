"""The operator's pages: static files, and the plotting script of the installed `plotly` package."""

from collections.abc import Callable, Coroutine, Mapping
from importlib.resources import files
from pathlib import Path

from fastapi import FastAPI
from fastapi.responses import FileResponse

_SCRIPTS = (
    "api",
    "app",
    "approval",
    "axes",
    "commands",
    "diagnosis",
    "elements",
    "experiment",
    "figures",
    "findings",
    "intent",
    "login",
    "machine",
    "motion",
    "moving",
    "refresh",
    "stream",
    "wayout",
)
_STATIC = Path(__file__).parent / "static"
# nothing is loaded from elsewhere, no inline script runs; plotly writes style attributes
_POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self' 'unsafe-inline'; img-src 'self' data:; "
    "base-uri 'none'; form-action 'none'; frame-ancestors 'none'; connect-src 'self'"
)
_HEADERS = {
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cache-Control": "no-cache",
}


def add_pages(app: FastAPI, stop_port: int | None) -> None:
    """``/``, ``/diagnosis`` and the files that they load. They may speak to this service and to the stop's port."""
    stop = "" if stop_port is None else f" http://*:{stop_port} https://*:{stop_port}"
    headers = _HEADERS | {"Content-Security-Policy": f"{_POLICY}{stop}"}
    plotly = Path(str(files("plotly").joinpath("package_data", "plotly.min.js")))
    pages = {
        "/": _STATIC / "index.html",
        "/diagnosis": _STATIC / "diagnosis.html",
        **{f"/{name}.js": _STATIC / f"{name}.js" for name in _SCRIPTS},
        "/style.css": _STATIC / "style.css",
        "/plotly.min.js": plotly,
    }
    for url, path in pages.items():
        app.add_api_route(url, _page(path, headers), response_class=FileResponse, include_in_schema=False)


def _page(path: Path, headers: Mapping[str, str]) -> Callable[[], Coroutine[None, None, FileResponse]]:
    async def page() -> FileResponse:
        return FileResponse(path, headers=headers)

    return page
