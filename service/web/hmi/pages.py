"""The operator's pages: static files, their texts, and the plotting script of the installed `plotly` package."""

import json
from collections.abc import Callable, Coroutine, Mapping
from html import escape
from importlib.resources import files
from pathlib import Path

from fastapi import FastAPI, Request
from fastapi.responses import FileResponse, HTMLResponse, Response
from fastapi.staticfiles import StaticFiles
from starlette.concurrency import run_in_threadpool

_Endpoint = Callable[[], Coroutine[None, None, Response]]

_PAGES = {
    "/": "index.html",
    "/plan": "plan.html",
    "/payload": "payload.html",
    "/results": "results.html",
    "/diagnosis": "diagnosis.html",
    "/fleet": "fleet.html",
}
_SHARED = ("commands", "ordered", "confirm")  # parts of several pages, beside the head of all
_PDF = ' data-pdf="report.pdf"'
_STATIC = Path(__file__).parent / "static"


def add_pages(app: FastAPI, stop_port: int | None, pdf: Callable[[], bool], behind_proxy: bool = False) -> None:
    """The pages and the files that they load. They may speak to this service and to the stop's port.

    `pdf`: whether the service makes PDF, for the link to it; may block.
    `behind_proxy`: they also send a stop to `stop` at their own origin, which the proxy forwards to that port.
    """
    # nothing is loaded from elsewhere, no inline script runs; plotly writes style attributes
    policy = (
        "default-src 'none'; script-src 'self'; style-src 'self' 'unsafe-inline'; img-src 'self' data:; "
        "worker-src 'self'; base-uri 'none'; form-action 'self'; frame-ancestors 'none'; connect-src 'self'"
    )
    stop = "" if stop_port is None else f" http://*:{stop_port} https://*:{stop_port}"
    headers = {
        "X-Content-Type-Options": "nosniff",
        "Referrer-Policy": "no-referrer",
        "Cache-Control": "no-cache",
        "Content-Security-Policy": f"{policy}{stop}",
    }
    plotly = str(files("plotly").joinpath("package_data", "plotly.min.js"))
    app.add_api_route("/plotly.min.js", _file(plotly, headers), response_class=FileResponse, include_in_schema=False)
    words = texts()
    # what a page says whose scripts did not load: in each language, as none was chosen
    dead = " ".join(f'<span lang="{tag}">{escape(own["head.dead"])}</span>' for tag, own in words.items())
    head = (_STATIC / "head.html").read_text("utf-8").replace("<!-- dead -->", dead)
    if behind_proxy and stop_port is not None:
        head = head.replace('data-proxied=""', 'data-proxied="stop"')  # of STOP, relative to the pages
    for url, name in _PAGES.items():
        app.add_api_route(
            url, _page(url, name, head, headers, pdf), response_class=HTMLResponse, include_in_schema=False
        )
    app.add_api_route("/texts.js", _texts(words, headers), response_class=Response, include_in_schema=False)
    for ending in ("js", "css"):
        path = f"/{{name}}.{ending}"
        app.add_api_route(path, _static(ending, headers), response_class=FileResponse, include_in_schema=False)


def texts() -> dict[str, dict[str, str]]:
    """Texts of the pages by language and key; English, the language of the service, is first."""
    files = sorted((Path(__file__).parent / "texts").glob("*.json"), key=lambda file: (file.stem != "en", file.stem))
    return {file.stem: json.loads(file.read_text("utf-8")) for file in files}


def _texts(words: Mapping[str, Mapping[str, str]], headers: Mapping[str, str]) -> _Endpoint:
    """A module, so that the scripts have the words before they run: STOP must not wait for another answer."""
    content = f"export const TEXTS = {json.dumps(words, ensure_ascii=False)};\n"

    async def module() -> Response:
        return Response(content, headers=headers, media_type="text/javascript")

    return module


def _static(ending: str, headers: Mapping[str, str]) -> Callable[[Request, str], Coroutine[None, None, Response]]:
    folder = StaticFiles(directory=_STATIC)

    async def file(request: Request, name: str) -> Response:
        response = await folder.get_response(f"{name}.{ending}", request.scope)
        response.headers.update(headers)
        return response

    return file


def _file(path: str, headers: Mapping[str, str]) -> _Endpoint:
    async def file() -> FileResponse:
        return FileResponse(path, headers=headers)

    return file


def _page(url: str, name: str, head: str, headers: Mapping[str, str], pdf: Callable[[], bool]) -> _Endpoint:
    """A page with the parts that it shares with others; in the head of all, its own link is the current one."""
    own = f'<a href="{url.removeprefix("/") or "./"}"'
    # who looks at any page can stop the machine
    head = head.replace(own, f'{own} aria-current="page"')
    content = (_STATIC / name).read_text("utf-8").replace("  <!-- head -->\n", head)
    for part in _SHARED:
        content = content.replace(f"<!-- {part} -->\n", (_STATIC / f"{part}.html").read_text("utf-8"))

    async def page() -> HTMLResponse:
        if _PDF in content and not await run_in_threadpool(pdf):
            return HTMLResponse(content.replace(_PDF, ""), headers=headers)
        return HTMLResponse(content, headers=headers)

    return page
