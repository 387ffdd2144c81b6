"""The report on paper: A4, every figure there and none of it cut."""

from pathlib import Path

import pytest
from playwright.sync_api import Page

from service.configuration import read_robot
from service.report import estimate_page
from tests.browser.browsing import browsing
from tests.programs import needs
from tests.unit.service.report.test_report import content, sweep

pytestmark = needs("chromium")

# what reaches over the paper's edge: of a figure its drawing, of all else its box
_CUT = """() => [...document.querySelectorAll(".main-svg, .printed, table, .facts, p, h1, h2, h3")]
  .filter((one) => one.checkVisibility() && one.getBoundingClientRect().right > 681)
  .map((one) => `${one.tagName} ${one.className.baseVal ?? one.className} ${one.getBoundingClientRect().right}`)"""


@pytest.fixture
def file(root: Path, tmp_path: Path) -> Path:
    robot = read_robot(root / "config" / "robots" / "max100-class.yaml")
    file = tmp_path / "report.html"
    file.write_text(estimate_page(content(robot, example=sweep())).html(), encoding="utf-8")
    return file


def on_paper(page: Page) -> None:
    """As when it is printed: the width between the margins of A4."""
    page.wait_for_function("'drawn' in document.documentElement.dataset")
    page.emulate_media(media="print")
    page.set_viewport_size({"width": 680, "height": 1000})
    page.evaluate("dispatchEvent(new Event('beforeprint'))")
    page.wait_for_function("[...document.querySelectorAll('.main-svg')].every((one) => one.clientWidth <= 680)")


def test_no_figure_is_cut_and_none_is_empty(file: Path) -> None:
    with browsing(file.as_uri()) as page:
        on_paper(page)
        assert page.evaluate(_CUT) == []
        pictures = page.locator("img.printed")
        assert pictures.count() == 1  # the surface, which the graphics card draws
        assert pictures.evaluate_all("all => all.map((one) => one.checkVisibility() && one.naturalWidth)") == [1920]
        assert not page.locator("img.printed + div").is_visible()
        figures = page.locator(".card > div").count()
        assert page.locator(".card > div:visible").count() == figures - 1
        page.evaluate("dispatchEvent(new Event('afterprint'))")
        assert page.pdf(prefer_css_page_size=True).startswith(b"%PDF")
