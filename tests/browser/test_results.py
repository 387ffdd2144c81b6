"""The page of results: what its lists and scales say."""

from playwright.sync_api import expect

from tests.browser.browsing import browsing
from tests.browser.scripted import Json, campaign, scripted
from tests.stored.documents import stored


def test_earlier_estimates_are_earlier_and_the_scale_of_convergence_has_its_numbers_in_full() -> None:
    made = [campaign(number, state="completed") for number in (1, 2, 3)]
    answers: dict[str, Json] = {"campaigns": {"items": made, "next": None}}
    for one in made:
        path = f"campaigns/{one['id']}"
        found = {"revision": 1, "number": 2, "document": stored("estimate")}
        percent = [{"sweep": sweep, "percent": {"joint_1": value}} for sweep, value in ((1, 4.0), (2, 0.3))]
        answers |= {path: one, f"{path}/estimates/latest": found}
        answers[f"{path}/estimates/convergence"] = {"wanted": None, "revisions": percent}
    with scripted(answers=answers) as service, browsing(f"{service.url}/results#campaign-2") as page:
        ticks = page.locator("#convergence .ytick")
        expect(ticks).not_to_have_count(0)
        assert ticks.all_text_contents() == ["0.5", "1", "2"]
        expect(page.locator("#earlier tbody tr").first).to_be_visible()
        assert {row.split()[0] for row in page.locator("#earlier tbody tr").all_inner_texts()} == {"2", "1"}
