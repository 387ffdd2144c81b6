"""The page of results: what its lists and scales say."""

import re

import pytest
from playwright.sync_api import expect

from tests.browser.browsing import browsing, window
from tests.browser.scripted import Json, campaign, scripted
from tests.stored.documents import stored
from tests.system.rest_bench import until


def test_earlier_estimates_are_earlier_and_the_scale_of_convergence_has_its_numbers_in_full() -> None:
    made = [campaign(number, state="completed") for number in (1, 2, 3)]
    answers: dict[str, Json] = {"campaigns": {"items": made, "next": None}}
    for one in made:
        path = f"campaigns/{one['id']}"
        found = {"revision": 1, "number": 2, "document": stored("estimate")}
        percent = [{"sweep": sweep, "percent": {"joint_1": value}} for sweep, value in ((1, 4.0), (2, 0.3), (3, None))]
        answers |= {path: one, f"{path}/estimates/latest": found}
        answers[f"{path}/estimates/convergence"] = {"wanted": None, "revisions": percent}
    with scripted(answers=answers) as service, browsing(f"{service.url}/results#campaign-2") as page:
        ticks = page.locator("#convergence .ytick")
        expect(ticks).not_to_have_count(0)
        assert ticks.all_text_contents() == ["0.5", "1", "2"]
        expect(page.locator("#wanted")).to_contain_text("not all base parameters are determined")
        expect(page.locator("#earlier tbody tr").first).to_be_visible()
        assert {row.split()[0] for row in page.locator("#earlier tbody tr").all_inner_texts()} == {"2", "1"}


@pytest.mark.parametrize(
    ("locale", "sheet"), [("en-US", "Sheet for the control"), ("de-DE", "Blatt für die Steuerung")]
)
@pytest.mark.parametrize("pdf", [True, False])
def test_downloads_are_what_the_service_makes(pdf: bool, locale: str, sheet: str) -> None:
    with scripted(answers=of_one(stored("estimate"))) as service:
        service.pdf = pdf
        with browsing(f"{service.url}/results#campaign-1", locale=locale) as page:
            expect(page.get_by_role("link", name=sheet)).to_have_attribute("href", re.compile("campaigns/1/sheet.md$"))
            assert page.locator("#downloads [href$='report.pdf']").count() == pdf
            assert page.locator("#downloads [href$='report.json']").count() == 1


def test_what_accepted_effects_did_to_the_estimate_is_told() -> None:
    document = stored("estimate")
    document["effects"] = [
        {"axis": "joint_1", "effect": name, "parameters": {}, "used": used, "how": how}
        for name, used, how in (("coulomb_friction", True, "subtracted"), ("backlash", False, "unknown in this pose"))
    ]
    document["axes"]["joint_1"]["effects_moved_in_std"] = 2.345
    document["condition_number"] = None
    with scripted(answers=of_one(document)) as service, browsing(f"{service.url}/results#campaign-1") as page:
        expect(page.locator("#taken p")).to_have_text(
            [
                "Taken into account: Coulomb friction of joint_1. subtracted",
                "Left out: backlash of joint_1. unknown in this pose",
                "The accepted effects moved J of joint_1 by up to 2.3 standard deviations.",
            ]
        )
        expect(page.locator("#told")).to_have_text("revision 1, after sweep 2")
        page.goto(f"{service.url}/#campaign-1")
        expect(page.locator("#estimate-text")).to_contain_text("moved J of joint_1 by up to 2.3 standard deviations.")


def test_what_one_failed_request_left_out_is_drawn_later() -> None:
    with scripted(answers=of_one(stored("estimate"))) as service, window() as context:
        page = context.new_page()
        page.route("**/convergence", lambda route: route.abort())
        page.goto(f"{service.url}/results#campaign-1", wait_until="commit")
        expect(page.locator("#wanted")).to_be_empty()
        expect(page.locator("#table tbody tr")).to_have_count(3)
        page.unroute("**/convergence")
        until(lambda: service.streams > 0, "the page follows the events")
        service.tell("estimate")
        expect(page.locator("#sweep option").first).to_be_attached()
        expect(page.locator("#earlier tbody tr").first).to_be_visible()


def of_one(document: Json) -> dict[str, Json]:
    """A completed campaign with this estimate."""
    one = campaign(1, state="completed")
    return {
        "campaigns": {"items": [one], "next": None},
        "campaigns/1": one,
        "campaigns/1/estimates/latest": {"revision": 1, "number": 2, "document": document},
        "campaigns/1/estimates/convergence": {"wanted": None, "revisions": []},
    }
