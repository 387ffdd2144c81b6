"""The page tells the truth first: what moves, never green in trouble, the way out, and nothing it does not know."""

import httpx
import pytest
from playwright.sync_api import Page, expect

from service.web.client import ServiceClient
from tests.browser.browsing import load_again
from tests.browser.looking import green
from tests.programs import needs
from tests.system.rest_bench import Service, VirtualMachine, add_plan, release, until

pytestmark = needs("chromium")
SILENCE = "The service does not answer. Assume that the machine moves: use the emergency stop"


def test_a_start_from_a_page_that_did_not_show_the_stop_is_refused(
    machine: VirtualMachine, service: Service, page: Page
) -> None:
    with ServiceClient(service.url) as client:
        campaign = int(client.add_campaign(add_plan(client, axes=["joint_1"], poses=1))["id"])
        start = page.get_by_role("button", name="Start")
        expect(start).to_be_enabled()
        before = {
            name: httpx.get(f"{service.url}/api/v1/{name}", trust_env=False).json() for name in ("stop", "drives")
        }
        # what the page shows stays as it is
        page.route("**/api/v1/stop", lambda route: route.fulfill(json=before["stop"]))
        page.route("**/api/v1/drives", lambda route: route.fulfill(json=before["drives"]))
        httpx.post(f"{service.url}/api/v1/stop", params={"by": "Ada", "why": "smoke"}, trust_env=False)
        release(client)
        start.click()
        expect(page.locator("#error")).to_contain_text(
            "stopped by Ada: smoke. Check the machine, then give the command"
        )
        assert machine.stands()
        assert client.campaign(campaign)["state"] == "planned"
        page.unroute_all(behavior="wait")
        load_again(page)
        start.click()
        until(lambda: not machine.stands(), "an axis with energy")
        client.abort(campaign, "enough seen")


def test_nothing_is_green_in_trouble_and_the_way_out_stands_there(machine: VirtualMachine, page: Page) -> None:
    way_out = page.locator("#way-out li")
    expect(page.locator("#machine")).to_have_text("all axes stand without energy")
    expect(page.locator("#intent")).to_have_class("still")
    assert green(page)  # so that the looking is known to find it
    expect(way_out).to_have_count(0)

    assert machine.order("fault", joint="joint_2", code=0x2310)["ok"]
    expect(page.locator("#machine")).to_have_text("fault of joint_2")
    assert green(page) == []
    expect(page.locator("#axes")).to_contain_text("2310h")
    expect(page.locator("#acknowledge-all")).to_be_hidden()
    expect(way_out).to_contain_text(["Check joint_2", "Acknowledge"])
    page.get_by_role("button", name="I looked: acknowledge").click()
    expect(page.locator("#axes")).not_to_contain_text("2310h")
    expect(page.locator("#machine")).to_have_text("all axes stand without energy")

    assert machine.order("emergency_stop", on=True)["ok"]
    expect(page.locator("#machine")).to_have_text("EMERGENCY STOP")
    assert green(page) == []
    expect(page.locator("#axes")).to_contain_text("EMERGENCY STOP: error 9000h")
    expect(way_out).to_contain_text(["Check the machine", "Unlock the machine's own emergency stop", "Acknowledge"])
    assert machine.order("emergency_stop", on=False)["ok"]
    page.get_by_role("button", name="acknowledge all axes").click()
    expect(page.locator("#axes")).not_to_contain_text("9000h")
    expect(page.locator("#machine")).to_have_text("all axes stand without energy")

    page.get_by_role("button", name="STOP").click()
    expect(page.locator("#machine")).to_have_text("stopped")
    assert green(page) == []
    expect(way_out).to_contain_text(["Check the machine", "Release the stop with your name"])

    machine.power_off()
    expect(page.locator("#machine")).to_contain_text("no machine")
    assert green(page) == []
    expect(page.locator("#way-out")).to_contain_text("an axis may still move")


@pytest.mark.parametrize("how", ["the network is lost", "the service hangs"])
def test_without_the_service_all_is_dimmed_and_after_its_return_nothing_of_it_is_left(page: Page, how: str) -> None:
    expect(page.locator("#machine")).to_have_text("all axes stand without energy")
    if how == "the network is lost":
        page.context.set_offline(True)
    else:
        page.route("**/api/v1/**", lambda route: None)
    expect(page.locator("#silence")).to_be_visible()
    expect(page.locator("#silence")).to_contain_text(SILENCE)
    assert green(page) == []
    assert page.locator("main").evaluate("main => main.inert && getComputedStyle(main).opacity < 0.6")
    expect(page.locator("#intent")).to_have_text("")
    if how == "the network is lost":
        page.context.set_offline(False)
    else:
        page.unroute_all(behavior="ignoreErrors")
    expect(page.locator("#silence")).to_be_hidden()
    expect(page.locator("#machine")).to_have_text("all axes stand without energy")
    expect(page.locator("#error")).to_be_hidden()
    assert page.locator("main").evaluate("main => !main.inert && getComputedStyle(main).opacity === '1'")


def test_resume_shows_what_it_moves_and_what_cannot_work_says_why(
    machine: VirtualMachine, service: Service, page: Page
) -> None:
    with ServiceClient(service.url) as client:
        campaign = int(client.add_campaign(add_plan(client, axes=["joint_1"], poses=2))["id"])
        client.start(campaign)
        until(lambda: not machine.stands(), "an axis with energy")
        expect(page.locator("#start")).to_be_hidden()
        expect(page.locator("#resume")).to_be_hidden()
        client.stop("a test", "to be resumed")
        until(lambda: client.campaign(campaign)["state"] == "paused", "the pause")
        resume = page.get_by_role("button", name="Resume")
        expect(page.locator("#why-resume")).to_have_text("the machine is stopped: release it first")
        expect(resume).to_be_disabled()
        release(client)
        expect(resume).to_be_enabled()
        expect(page.locator("#why-resume")).to_have_text("")
        expect(page.locator("#pause")).to_be_hidden()
        expect(page.locator("#ordered-title")).to_have_text("What Resume will move")
        told = client.campaign(campaign)["progress"]
        expect(page.locator("#motion")).to_contain_text("2 sweeps of joint_1 in 2 poses")
        by_plan = "by the plan; the pace is known after two sweeps"
        expect(page.locator("#takes")).to_have_text(f"takes {duration(told['remaining'] + told['repeat'])} {by_plan}")
        page.get_by_label("measure interrupted and failed sweeps again").uncheck()
        expect(page.locator("#motion")).to_contain_text("1 sweep of joint_1 in 1 pose")
        expect(page.locator("#takes")).to_have_text(f"takes {duration(told['remaining'])} {by_plan}")


def duration(seconds: float) -> str:
    minutes, left = divmod(round(seconds), 60)
    return f"{minutes} min {left} s" if minutes else f"{left} s"
