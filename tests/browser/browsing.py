"""A page in the Chromium of this computer."""

from collections.abc import Iterator
from contextlib import contextmanager

from playwright.sync_api import BrowserContext, Page, expect, sync_playwright

from tests.programs import path_of

PATIENCE = 60_000  # ms, for whatever the page is to do or to show
CHROMIUM = path_of("chromium")
QUIET = ("--no-sandbox", "--disable-gpu", "--disable-background-networking", "--no-first-run", "--disable-sync")


@contextmanager
def browsing(url: str, any_certificate: bool = False, locale: str = "en-US") -> Iterator[Page]:
    """The page at `url` in a browser that wants `locale`; an error of its scripts fails the test."""
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=QUIET)
        page = browser.new_page(ignore_https_errors=any_certificate, locale=locale)
        page.set_default_timeout(PATIENCE)
        expect.set_options(timeout=PATIENCE)
        errors: list[str] = []
        missing: list[str] = []
        page.on("pageerror", lambda error: errors.append(str(error)))
        page.on("requestfailed", lambda request: missing.append(f"{request.url}: {request.failure}"))
        page.on("response", lambda answer: missing.extend([f"{answer.url}: {answer.status}"] * (answer.status >= 400)))
        page.goto(url, wait_until="commit")
        try:
            yield page
        except Exception as error:
            error.add_note(f"the page did not get: {missing}; its errors: {errors}")
            raise
        browser.close()
        assert errors == []


@contextmanager
def window(locale: str = "en-US", script: str = "") -> Iterator[BrowserContext]:
    """Its pages share their connections, as those of one browser do. `script` runs before those of each page."""
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=QUIET)
        context = browser.new_context(locale=locale)
        context.set_default_timeout(PATIENCE)
        expect.set_options(timeout=PATIENCE)
        errors: list[str] = []
        context.on("weberror", lambda error: errors.append(str(error.error)))
        if script:
            context.add_init_script(script)
        yield context
        browser.close()
        assert errors == []


def load_again(page: Page) -> None:
    """Load the page again; Chromium refuses that of a page that it has not begun to show."""
    page.wait_for_load_state("domcontentloaded")
    page.reload(wait_until="commit")
