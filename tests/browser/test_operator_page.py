"""The operator's page in a real browser, on a real service with the virtual machine behind it."""

import math

import httpx
from playwright.sync_api import Locator, Page, Route, expect

from service.web.client import ServiceClient
from tests.browser.browsing import load_again
from tests.programs import needs
from tests.system.rest_bench import Service, VirtualMachine, add_plan, release, until

pytestmark = needs("chromium")


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


def test_a_lost_machine_is_never_called_at_rest(machine: VirtualMachine, service: Service, page: Page) -> None:
    intent = page.locator("#intent")
    expect(intent).to_have_class("still")
    with ServiceClient(service.url) as client:
        client.add_campaign(add_plan(client, axes=["joint_1"], poses=1))
    page.get_by_role("button", name="Start").click()
    until(lambda: not machine.stands(), "an axis with energy")
    expect(intent).to_have_class("moving")
    machine.power_off()
    expect(intent).to_contain_text("The state of the axes is not known. Look at the machine. Cause: ")
    expect(intent).to_contain_text("Campaign 1 is paused (")
    expect(intent).to_contain_text("the drive does not answer")
    expect(intent).to_have_class("unknown")
    expect(page.locator("#axes tr", has_text="unknown")).to_have_count(6)


def test_what_start_will_move_stands_beside_it(service: Service, page: Page) -> None:
    with ServiceClient(service.url) as client:
        plan = add_plan(client, axes=["joint_1"], poses=2)
        document = client.plan(plan)["document"]
        campaign = client.add_campaign(plan)
    windows = [bound for sweep in document["sweeps"] for bound in sweep["position_window"]]
    targets = [leg["target"] for sweep in document["sweeps"] for leg in sweep["legs"] if leg["joint"] == "joint_1"]
    low, high = (degrees(extreme([*windows, *targets])) for extreme in (min, max))
    takes = campaign["progress"]["remaining"]
    assert takes > document["duration"]  # the check moves come to it
    minutes, seconds = divmod(round(takes), 60)
    told = f"{minutes} min {seconds} s" if minutes else f"{seconds} s"
    motion = page.locator("#motion")
    expect(motion).to_contain_text(f"max100-class: 2 sweeps of joint_1 in 2 poses, {told} with all moves between poses")
    expect(motion).to_contain_text(f"joint_1 is moved between {low} and {high}, at most {degrees(0.1)}/s, in 2 sweeps")
    expect(motion.locator("tbody tr")).to_have_count(2)
    expect(page.locator("#takes")).to_have_text(f"takes {told}")
    expect(page.locator("#progress-text")).to_have_text("0 of 2 sweeps")
    expect(commands(page)).to_have_text(["Start", "Abort"])
    page.get_by_role("button", name="Start").click()
    expect(page.locator("#campaign-state")).to_have_text("running")
    expect(commands(page)).to_have_text(["Pause", "Abort"])
    expect(page.locator("#ordered")).to_be_hidden()


def test_a_check_move_is_told_while_it_is_under_way(service: Service, page: Page) -> None:
    """It lasts a second or two: here for as long as the answer says so."""
    under_way: list[dict[str, object]] = [{"axis": "joint_2", "way": -0.0087266, "unit": "rad"}]

    def answer(route: Route) -> None:
        real = route.fetch()
        route.fulfill(
            response=real, json={**real.json(), "state": "running", "check_move": under_way[0] if under_way else None}
        )

    with ServiceClient(service.url) as client:
        campaign = int(client.add_campaign(add_plan(client, axes=["joint_1"], poses=1))["id"])
        page.route(f"**/api/v1/campaigns/{campaign}", answer)
        client.start(campaign)
    told = page.locator("#check-move")
    expect(told).to_contain_text("joint_2 goes \u22120.5\u00b0 and back")
    under_way.clear()  # no event tells it: the page asks by itself
    expect(told).to_be_hidden()
    page.unroute_all(behavior="wait")


def commands(page: Page) -> Locator:
    """Those that a person can see."""
    return page.locator("#commands button:visible")


def degrees(angle: float) -> str:
    """As the page tells an angle in rad."""
    return f"{math.degrees(angle):.3g}\u00b0".replace("-", "\u2212")
