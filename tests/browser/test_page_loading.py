"""A page whose scripts do not come says so, and its STOP works; the charts come last."""

from collections.abc import Iterator
from pathlib import Path

import pytest
from playwright.sync_api import Page, expect

from service.client import ServiceClient
from tests.browser.browsing import browsing, load_again
from tests.programs import needs
from tests.system.rest_bench import Service, serving, until
from tests.unit.service.api.conftest import profile

__all__ = ["profile"]

pytestmark = needs("chromium")


@pytest.fixture
def service(tmp_path: Path, profile: Path) -> Iterator[Service]:
    """No machine answers it."""
    with serving(tmp_path, profile) as service:
        yield service


@pytest.fixture
def page(service: Service) -> Iterator[Page]:
    with browsing(service.url) as page:
        yield page


@pytest.mark.parametrize("script", ["app", "words", "texts"])
def test_a_page_without_its_scripts_says_so_and_its_stop_stops(page: Page, service: Service, script: str) -> None:
    dead = page.locator("#dead")
    expect(page.locator("#machine")).to_contain_text("no machine: ")
    expect(dead).to_be_hidden()
    page.route(f"**/{script}.js", lambda route: route.abort())
    load_again(page)
    expect(dead).to_be_visible()
    expect(dead).to_contain_text("This page has not loaded")
    expect(dead).to_contain_text("Diese Seite ist nicht geladen")
    page.get_by_role("button", name="STOP").click()
    with ServiceClient(service.url) as client:
        until(client.stops, "the stop")
        assert [(stop["by"], stop["why"]) for stop in client.stops()] == [("operator page", "stop button")]


def test_the_stop_does_not_wait_for_the_charts(page: Page) -> None:
    page.route("**/plotly.min.js", lambda route: None)  # never answered
    load_again(page)
    expect(page.locator("#machine")).to_contain_text("no machine: ")
    page.get_by_role("button", name="STOP").click()
    expect(page.locator("#held-by")).to_contain_text("Stopped by operator page: stop button")
    expect(page.locator("#dead")).to_be_hidden()
