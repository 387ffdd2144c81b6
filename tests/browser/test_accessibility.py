"""axe-core on the pages, in light and dark, in the states in which an operator meets them."""

from pathlib import Path

from playwright.sync_api import Page, expect

from service.client import ServiceClient
from service.configuration import read_robot
from service.report import estimate_page
from tests.browser.accessible import both_schemes
from tests.browser.browsing import browsing
from tests.programs import needs
from tests.system.rest_bench import Service, VirtualMachine, add_plan, serving, until
from tests.unit.service.api.conftest import profile  # noqa: F401 - no machine
from tests.unit.service.report.test_report import content, sweep

pytestmark = needs("chromium")


def test_the_operators_page(machine: VirtualMachine, service: Service, page: Page) -> None:
    expect(page.locator("#machine")).to_have_text("all axes stand without energy")
    assert both_schemes(page) == []
    with ServiceClient(service.url) as client:
        campaign = int(client.add_campaign(add_plan(client, axes=["joint_1"], poses=2))["id"])
        expect(page.locator("#ordered")).to_be_visible()
        assert both_schemes(page) == []
        client.start(campaign)
        expect(page.locator("#campaign-state")).to_have_text("running")
        assert both_schemes(page) == []
        assert machine.order("fault", joint="joint_2", code=0x2310)["ok"]
        expect(page.locator("#axes")).to_contain_text("2310h")
        client.stop("a test", "to look at it")
        expect(page.locator("#held")).to_be_visible()
        expect(page.locator("#campaign-state")).to_have_text("paused")
        until(machine.stands, "standing axes")
        assert both_schemes(page) == []
        page.get_by_role("button", name="Abort", exact=True).click()
        expect(page.locator("#abort-question")).to_be_visible()
        assert both_schemes(page) == []
    page.context.set_offline(True)
    expect(page.locator("#silence")).to_be_visible()
    assert both_schemes(page) == []
    page.context.set_offline(False)
    expect(page.locator("#silence")).to_be_hidden()
    for other in ("plan", "results", "diagnosis", "fleet"):
        page.goto(f"{service.url}/{other}", wait_until="commit")
        expect(page.locator("#held")).to_be_visible()
        expect(page.get_by_role("button", name="STOP")).to_be_in_viewport()
        assert both_schemes(page) == [], other


def test_who_is_not_logged_in(tmp_path: Path, profile: Path) -> None:  # noqa: F811
    with serving(tmp_path, profile, login=True) as service, browsing(service.url) as page:
        expect(page.locator("#login")).to_be_visible()
        page.locator("#language").select_option("de")
        expect(page.get_by_role("button", name="Anmelden")).to_be_visible()
        assert both_schemes(page) == []


def test_a_report(root: Path, tmp_path: Path) -> None:
    robot = read_robot(root / "config" / "robots" / "max100-class.yaml")
    file = tmp_path / "report.html"
    file.write_text(estimate_page(content(robot, example=sweep())).html(), encoding="utf-8")
    with browsing(file.as_uri()) as page:
        assert both_schemes(page) == []
