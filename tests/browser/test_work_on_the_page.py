"""All of the work on the page: plan with a picture, start, live samples, results, downloads, the audit."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from playwright.sync_api import Page, expect

from service.planning.documents import DiagnosisRequest, PlanRequest
from service.web.client import Json, ServiceClient
from tests.browser.accessible import both_schemes
from tests.browser.browsing import browsing
from tests.browser.looking import cut, faint, settled, small, too_wide, unlike_ink
from tests.browser.scripted import scripted
from tests.browser.test_german import everything
from tests.programs import needs
from tests.system.rest_bench import Service, VirtualMachine, serving, until, virtual_machine

pytestmark = needs("chromium")


@pytest.fixture
def machine(tmp_path: Path) -> Iterator[VirtualMachine]:
    """Faster than a real one: long moves end in time on a busy computer. A slow browser still sees a sweep."""
    with virtual_machine(tmp_path, speed_factor=2.0) as machine:
        yield machine


@pytest.fixture
def service(tmp_path: Path, machine: VirtualMachine) -> Iterator[Service]:
    with serving(tmp_path, machine.profile) as service:
        yield service


def test_from_the_plan_to_the_results(service: Service) -> None:
    with browsing(f"{service.url}/plan") as page, ServiceClient(service.url) as client:
        expect(page.locator("#axes-measured input")).to_have_count(6)
        for joint in ("joint_2", "joint_3"):
            page.locator(f"#axes-measured [value={joint}]").uncheck()
        page.locator("#amount").fill("2")
        look(page)
        page.get_by_role("button", name="Make the plan").click()
        expect(page.locator("#planned")).to_be_visible()
        expect(page.locator("#views svg")).to_have_count(2)
        assert page.locator("#views polygon.link").count() > 10
        expect(page.locator("#picture-told")).to_contain_text("joint_2 ")
        expect(page.locator("#motion li").last).to_contain_text("Fieldbus: the drives make")
        before = page.locator("#views svg").first.inner_html()
        page.locator("#leg").select_option("0")
        expect(page.locator("#picture-told")).to_contain_text("joint_2 0")
        assert page.locator("#views svg").first.inner_html() != before
        expect(page.locator("#grid .trace.scatter, #grid .scatterlayer .trace")).not_to_have_count(0)
        look(page)
        page.get_by_role("button", name="Make a campaign of it").click()
        page.locator("#taken a").click()
        page.get_by_role("button", name="Start", exact=True).click()
        expect(page.locator("#live-title")).to_have_text("Live: sweep of joint_1")
        expect(page.locator("#live-chart .scatterlayer .trace")).to_have_count(2)
        assert page.locator("#live-chart").evaluate("chart => chart.data[0].x.length") > 2
        expect(page.locator("#live-chart")).to_contain_text("\u00b0/s")  # the unit of the table of axes
        campaign = client.campaigns()[-1]["id"]
        until(lambda: client.campaign(campaign)["state"] == "completed", "the campaign")
        expect(page.locator("#live")).to_be_hidden()
        page.goto(f"{service.url}/results#campaign-{campaign}", wait_until="commit")
        expect(page.locator("#table tbody tr")).to_have_count(1)
        expect(page.locator("#table tbody")).to_contain_text("%")
        expect(page.locator("#response .scatterlayer .trace")).to_have_count(2)
        expect(page.locator("#convergence .scatterlayer .trace")).not_to_have_count(0)
        expect(page.locator("#audit tbody")).to_contain_text(f"Campaign {campaign} started")
        expect(page.locator("#earlier tbody tr")).to_have_count(1)
        look(page)
        with page.expect_download() as bundle:
            page.locator("#downloads a").first.click()
        assert bundle.value.path().stat().st_size > 1000


def test_a_diagnosis_is_planned_on_the_page(service: Service) -> None:
    with browsing(f"{service.url}/plan") as page, ServiceClient(service.url) as client:
        expect(page.locator("#axes-measured input")).to_have_count(6)
        for joint in ("joint_1", "joint_3"):
            page.locator(f"#axes-measured [value={joint}]").uncheck()
        page.locator("#budget").select_option("diagnosis")
        page.locator("#amount").fill("1")
        page.get_by_role("button", name="Make the plan").click()
        expect(page.locator("#promise")).to_contain_text("order the diagnosis on the page Diagnosis")
        expect(page.locator("#views svg")).to_have_count(2)
        expect(page.locator("#grid")).to_be_hidden()
        expect(page.locator("#motion")).to_contain_text("reversal")
        page.locator("#take").click()
        expect(page.locator("#taken a")).to_be_visible()
        assert client.plan(client.campaigns()[-1]["plan_id"])["document"]["request"]["kind"] == "diagnosis"


def test_the_plan_page_begins_with_the_defaults_of_the_command(root: Path) -> None:
    some: Json = {"robot_id": 2, "axes": ("joint_1",), "varied": ("joint_2",)}
    given = everything(root)
    given["robots"]["items"].append(given["robots"]["items"][0] | {"id": 3, "name": "a newer one"})
    given["cells"]["names"].insert(0, "another")
    with scripted(answers=given) as service, browsing(f"{service.url}/plan") as page:
        expect(page.locator("#axes-measured input").first).to_be_attached()
        shown = [page.locator(f"#{name}").input_value() for name in ("amount", "step")]
        plan = PlanRequest.model_validate(some)
        assert [float(one) for one in shown] == [plan.poses, plan.step]  # before anything is chosen
        for budget, request in (
            ("poses", plan),
            ("diagnosis", DiagnosisRequest.model_validate(some | {"kind": "diagnosis"})),
        ):
            page.locator("#budget").select_option(budget)
            with page.expect_request(lambda one: one.method == "POST" and one.url.endswith("/plans")) as sent:
                page.locator("#make").click()
            wanted: Any = sent.value.post_data_json
            assert (wanted["poses"], wanted["step"]) == (request.poses, request.step), budget
            assert (wanted["robot_id"], wanted["cell"]) == (2, "workshop")  # those of the machine
            expect(page.locator("#make")).to_be_enabled()


def test_an_amount_that_is_no_number_is_told(root: Path) -> None:
    with scripted(answers=everything(root)) as service, browsing(f"{service.url}/plan") as page:
        expect(page.locator("#axes-measured input").first).to_be_attached()
        page.locator("#amount").fill("many")
        page.get_by_role("button", name="Make the plan").click()
        expect(page.locator("#error")).to_have_text("many is not a number above 0")


def look(page: Page) -> None:
    assert both_schemes(page) == []  # dark is the last
    assert unlike_ink(page) == []
    for width in (768, 1920):
        page.set_viewport_size({"width": width, "height": 1000})
        settled(page)
        assert (faint(page), small(page), cut(page), too_wide(page)) == ([], [], [], False), width
