"""The operator's page in a real browser, on a real service with the virtual machine behind it."""

from collections.abc import Iterator
from pathlib import Path

import pytest
from playwright.sync_api import Page, Route, expect

from service.client import ServiceClient
from tests.browser.browsing import PATIENCE, WITHOUT_BROWSER, browsing
from tests.system.rest_bench import Service, VirtualMachine, add_plan, serving, until, virtual_machine

pytestmark = WITHOUT_BROWSER


@pytest.fixture
def machine(tmp_path: Path) -> Iterator[VirtualMachine]:
    with virtual_machine(tmp_path, speed_factor=2.0) as machine:
        yield machine


@pytest.fixture
def service(tmp_path: Path, machine: VirtualMachine) -> Iterator[Service]:
    with serving(tmp_path, machine.profile) as service:
        yield service


@pytest.fixture
def page(service: Service) -> Iterator[Page]:
    with browsing(service.url) as page:
        yield page


def test_stop_and_release(machine: VirtualMachine, service: Service, page: Page) -> None:
    with ServiceClient(service.url) as client:
        campaign = int(client.add_campaign(add_plan(client, axes=["joint_1"], poses=2))["id"])
        page.get_by_role("button", name="Start").click()
        until(lambda: not machine.stands(), "an axis with energy")
        page.get_by_role("button", name="STOP").click()
        expect(page.locator("#held-by")).to_contain_text("Stopped by operator page: stop button", timeout=PATIENCE)
        until(machine.stands, "standing axes")
        expect(page.locator("#campaign-state")).to_have_text("paused", timeout=PATIENCE)
        page.get_by_label("Your name").fill("Ada")
        page.get_by_role("button", name="I looked at the machine: release").click()
        expect(page.locator("#held")).to_be_hidden(timeout=PATIENCE)
        assert machine.stands()
        assert client.campaign(campaign)["state"] == "paused"


def test_a_fault_is_shown_and_acknowledged_by_a_person(machine: VirtualMachine, page: Page) -> None:
    expect(page.locator("#machine")).to_have_text("machine connected", timeout=PATIENCE)
    assert machine.order("fault", joint="joint_2", code=0x2310)["ok"]
    expect(page.locator("#axes")).to_contain_text("2310h", timeout=PATIENCE)
    page.get_by_role("button", name="I looked: acknowledge").click()
    expect(page.locator("#axes")).not_to_contain_text("2310h", timeout=PATIENCE)
    assert machine.stands()


def test_a_check_move_is_told_while_it_is_under_way(service: Service, page: Page) -> None:
    """It lasts a second or two: here for as long as the answer says so."""
    under_way: list[dict[str, object]] = [{"axis": "joint_2", "way": -0.0087266, "unit": "rad"}]

    def answer(route: Route) -> None:
        real = route.fetch()
        route.fulfill(response=real, json={**real.json(), "check_move": under_way[0] if under_way else None})

    page.route("**/api/v1/campaigns/1", answer)
    with ServiceClient(service.url) as client:
        client.add_campaign(add_plan(client, axes=["joint_1"], poses=1))
    told = page.locator("#check-move")
    expect(told).to_contain_text("joint_2 goes \u22120.5\u00b0 and back", timeout=PATIENCE)
    under_way.clear()  # no event tells it: the page asks by itself
    expect(told).to_be_hidden(timeout=PATIENCE)
    page.unroute_all(behavior="wait")
