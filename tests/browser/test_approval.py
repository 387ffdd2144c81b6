"""With `approval: true` the page says what waits for whom, and its button approves what it names."""

from collections.abc import Iterator
from pathlib import Path

import pytest
from playwright.sync_api import Page, expect

from service.web.client import ServiceClient
from tests.browser.browsing import browsing
from tests.browser.looking import faint, small
from tests.programs import needs
from tests.system.rest_bench import Service, add_plan, serving
from tests.unit.service.api.conftest import profile  # noqa: F401 - no machine

pytestmark = needs("chromium")


@pytest.fixture
def service(tmp_path: Path, profile: Path) -> Iterator[Service]:  # noqa: F811
    with serving(tmp_path, profile, approval=True) as service:
        yield service


@pytest.fixture
def page(service: Service) -> Iterator[Page]:
    with browsing(service.url) as page:
        yield page


def test_a_plan_is_approved_where_it_is_shown(service: Service, page: Page) -> None:
    with ServiceClient(service.url) as client:
        plan = add_plan(client, axes=["joint_1"], poses=1)
        client.add_campaign(plan)
        why = f"plan {plan} requires the approval of an engineer: not approved yet"
        expect(page.locator("#why-start")).to_have_text(why)
        expect(page.locator("#start")).to_be_disabled()
        expect(page.locator("#approve-why")).to_have_text(why)
        count = len(client.plan(plan)["document"]["sweeps"])
        approve = page.locator("#approve-it")
        expect(approve).to_contain_text(f"Approve: joint_1, {count} sweep")
        assert (faint(page), small(page)) == ([], [])
        page.locator("#approve-by").fill("Ada")
        approve.click()
        expect(page.locator("#approve")).to_be_hidden()
        expect(page.locator("#start")).to_be_enabled()
        (given,) = client.approvals(plan)["items"]
        assert (given["approved_by"], given["void"]) == ("Ada", "")
