"""The language of a page: the browser's, or the one chosen on it, also while a campaign runs; numbers and dates."""

import pytest
from playwright.sync_api import expect

from tests.browser.browsing import browsing, load_again
from tests.browser.scripted import HELD, Json, campaign, scripted
from tests.programs import needs

pytestmark = needs("chromium")


def test_the_language_changes_while_a_campaign_runs_and_is_remembered() -> None:
    runs = campaign(state="running")
    answers: dict[str, Json] = {"campaigns": {"items": [runs], "next": None}, "campaigns/1": runs}
    with scripted(answers=answers) as service, browsing(service.url, locale="de-DE") as page:
        expect(page.locator("#intent")).to_contain_text("Die Maschine bewegt sich")
        page.locator("#language").select_option("en")
        expect(page.locator("#intent")).to_contain_text("The machine moves: Campaign 1 runs")
        expect(page.locator("html")).to_have_attribute("lang", "en")
        expect(page.get_by_role("button", name="Abort", exact=True)).to_be_visible()
        service.answers["stop"] |= {"latched": True, "stops": [HELD]}
        expect(page.locator("#held-by")).to_have_text("Stopped by operator page: stop button")
        page.get_by_label("Your name").fill("Ada")
        page.locator("#language").select_option("de")  # what was typed stays
        expect(page.get_by_label("Ihr Name")).to_have_value("Ada")
        page.locator("#language").select_option("en")
        load_again(page)
        expect(page.locator("#held-by")).to_contain_text("Stopped by")
        page.get_by_role("link", name="Diagnosis").click()
        expect(page.locator("#new-title")).to_have_text("Diagnose measured campaigns")
        page.locator("#language").select_option("de")
        expect(page).to_have_title("sweepid Diagnose")
        expect(page.locator("#model option")).to_have_text(["keine"])


@pytest.mark.parametrize(
    ("locale", "language", "number", "date"),
    [
        ("en-GB", "en", "2.5", "2 Mar 2026"),
        ("en-US", "en", "2.5", "Mar 2, 2026"),
        ("de-DE", "de", "2,5", "02.03.2026"),
        ("de-CH", "de", "2.5", "02.03.2026"),
        ("fr-FR", "en", "2.5", "Mar 2, 2026"),
    ],
)
def test_dates_and_decimal_signs_are_those_of_the_country(locale: str, language: str, number: str, date: str) -> None:
    """English is not American, and Switzerland writes a decimal point. A language that there is not is English."""
    with scripted() as service, browsing(service.url, locale=locale) as page:
        expect(page.locator("html")).to_have_attribute("lang", language)
        expect(page.locator("#language")).to_have_value(language)
        told = page.evaluate(
            """async () => {
              const words = await import("./words.js");
              return [words.figures(2.5, 3), words.moment("2026-03-02T12:00:00Z"), words.separators()[0]];
            }"""
        )
        assert (told[0], date in told[1], told[2]) == (number, True, number[1]), told
