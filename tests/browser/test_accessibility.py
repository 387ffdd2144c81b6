"""axe-core, contrast and size on the pages, light and dark, in the states in which an operator meets them."""

from playwright.sync_api import Page, expect

from service.web.client import ServiceClient
from tests.browser.accessible import both_schemes, findings
from tests.browser.browsing import window
from tests.browser.looking import faint, settled, small, too_wide
from tests.browser.scripted import scripted
from tests.programs import needs
from tests.system.rest_bench import Service, VirtualMachine, add_plan, until

pytestmark = needs("chromium")


def look(page: Page) -> None:
    for scheme in ("light", "dark"):
        page.emulate_media(color_scheme="dark" if scheme == "dark" else "light")
        settled(page)
        assert findings(page) == [], scheme
        for width in (768, 1280, 1920):
            page.set_viewport_size({"width": width, "height": 1000})
            page.mouse.wheel(0, 2000)
            settled(page)
            for banner in page.locator(".banner:visible").all():
                expect(banner).to_be_in_viewport()  # however far it is scrolled
            assert (faint(page), small(page), too_wide(page)) == ([], [], False), (scheme, width)


def test_the_operators_page(machine: VirtualMachine, service: Service, page: Page) -> None:
    expect(page.locator("#machine")).to_have_text("all axes stand without energy")
    look(page)
    with ServiceClient(service.url) as client:
        campaign = int(client.add_campaign(add_plan(client, axes=["joint_1"], poses=2))["id"])
        expect(page.locator("#ordered")).to_be_visible()
        look(page)
        client.start(campaign)
        expect(page.locator("#campaign-state")).to_have_text("running")
        look(page)
        assert machine.order("emergency_stop", on=True)["ok"]
        expect(page.locator("#machine")).to_contain_text("EMERGENCY STOP")
        expect(page.locator("#campaign-state")).to_have_text("paused")
        look(page)
        client.stop("a test", "to look at it")
        expect(page.locator("#held")).to_be_visible()
        until(machine.stands, "standing axes")
        look(page)
        page.get_by_role("button", name="Abort", exact=True).click()
        expect(page.locator("#abort-question")).to_be_visible()
        look(page)
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


def test_who_is_not_logged_in() -> None:
    with scripted() as service, window() as context:
        service.known = set()
        page = context.new_page()
        page.goto(service.url, wait_until="commit")
        expect(page.locator("#login")).to_be_visible()
        page.locator("#language").select_option("de")
        expect(page.get_by_role("button", name="Anmelden")).to_be_visible()
        assert both_schemes(page) == []
