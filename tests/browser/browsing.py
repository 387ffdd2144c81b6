"""A page in the Chromium of this computer."""

from collections.abc import Iterator
from contextlib import contextmanager

from playwright.sync_api import Browser, BrowserContext, Page, expect, sync_playwright

from tests.programs import path_of

PATIENCE = 180_000  # ms, for whatever the page is to do or to show
CHROMIUM = path_of("chromium")
QUIET = ("--no-sandbox", "--disable-gpu", "--disable-background-networking", "--no-first-run", "--disable-sync")


_OPEN: list[Browser] = []


@contextmanager
def chromium() -> Iterator[Browser]:
    """The browser that is open already, or one until the end of the block."""
    if _OPEN:
        yield _OPEN[0]
        return
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=QUIET)
        expect.set_options(timeout=PATIENCE)
        _OPEN.append(browser)
        try:
            yield browser
        finally:
            _OPEN.clear()
            browser.close()


@contextmanager
def window(locale: str = "en-US", script: str = "", any_certificate: bool = False) -> Iterator[BrowserContext]:
    """A browser of its own, as far as pages can tell; an error of their scripts fails the test.

    Its pages share their connections. `script` runs before those of each page.
    """
    with chromium() as browser:
        context = browser.new_context(locale=locale, ignore_https_errors=any_certificate)
        context.set_default_timeout(PATIENCE)
        errors: list[str] = []
        context.on("weberror", lambda error: errors.append(str(error.error)))
        if script:
            context.add_init_script(script)
        try:
            yield context
        except Exception as error:
            error.add_note(f"errors of scripts: {errors}")
            raise
        finally:
            context.close()
        assert errors == []


@contextmanager
def browsing(url: str, any_certificate: bool = False, locale: str = "en-US") -> Iterator[Page]:
    """The page at `url` in a window that wants `locale`."""
    with window(locale, any_certificate=any_certificate) as context:
        page, missing = context.new_page(), list[str]()
        page.on("requestfailed", lambda request: missing.append(f"{request.url}: {request.failure}"))
        page.on("response", lambda answer: missing.extend([f"{answer.url}: {answer.status}"] * (answer.status >= 400)))
        page.goto(url, wait_until="commit")
        try:
            yield page
        except Exception as error:
            error.add_note(f"the page did not get: {missing}")
            raise


def load_again(page: Page) -> None:
    """Load the page again; Chromium refuses that of a page that it has not begun to show."""
    page.wait_for_load_state("domcontentloaded")
    page.reload(wait_until="commit")
