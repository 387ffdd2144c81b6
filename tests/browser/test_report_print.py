"""The report: read by everybody on the screen, and on paper A4, every figure there and none of it cut."""

from pathlib import Path

from service.model.configuration import read_robot
from tests.browser.accessible import both_schemes
from tests.browser.browsing import browsing
from tests.programs import needs
from tests.unit.service.report.test_report import content, estimate_page, sweep

pytestmark = needs("chromium")

_CUT = """() => [...document.querySelectorAll("svg, table, .facts, p, h1, h2, h3")]
  .filter((one) => one.getBoundingClientRect().right > 681)
  .map((one) => `${one.tagName} ${one.getBoundingClientRect().right}`)"""


def test_it_is_accessible_and_on_paper_no_figure_is_cut_and_none_is_empty(root: Path, tmp_path: Path) -> None:
    robot = read_robot(root / "config" / "robots" / "max100-class.yaml")
    file = tmp_path / "report.html"
    file.write_text(estimate_page(content(robot, example=sweep())).html(), encoding="utf-8")
    with browsing(file.as_uri()) as page:
        assert both_schemes(page) == []
        page.emulate_media(media="print")
        page.set_viewport_size({"width": 680, "height": 1000})  # of A4, between its margins
        assert page.evaluate(_CUT) == []
        sizes = page.locator("figure svg").evaluate_all("all => all.map((one) => one.getBBox().height)")
        assert len(sizes) == 8
        assert min(sizes) > 100
        assert page.pdf(prefer_css_page_size=True).startswith(b"%PDF")
