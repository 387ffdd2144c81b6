"""The page in German: what it says, that STOP is STOP, and that the language may change while the machine moves."""

from collections.abc import Iterator

import pytest
from playwright.sync_api import Page, expect

from service.web.client import ServiceClient
from tests.browser.browsing import browsing, load_again
from tests.browser.looking import cut, faint, settled, small, too_wide
from tests.browser.scripted import scripted
from tests.programs import needs
from tests.system.rest_bench import Service, VirtualMachine, add_plan, until

pytestmark = needs("chromium")
NARROW, WIDE = 768, 1920  # px


@pytest.fixture
def page(service: Service) -> Iterator[Page]:
    """In a browser that wants German."""
    with browsing(service.url, locale="de-DE") as page:
        yield page


def look(page: Page) -> None:
    for width in (NARROW, WIDE):
        page.set_viewport_size({"width": width, "height": 1000})
        settled(page)
        assert (faint(page), small(page), cut(page), too_wide(page)) == ([], [], [], False), width


def test_german_from_standstill_to_a_stop_and_its_release(
    machine: VirtualMachine, service: Service, page: Page
) -> None:
    expect(page.locator("#machine")).to_have_text("alle Achsen stehen ohne Energie")
    expect(page.locator("html")).to_have_attribute("lang", "de")
    expect(page.locator("#axes td.number").first).to_have_text("0,00\u00b0")  # before any campaign
    look(page)
    with ServiceClient(service.url) as client:
        client.add_campaign(add_plan(client, axes=["joint_1"], poses=2))
    expect(page.locator("#ordered-title")).to_have_text("Was \u201eStart\u201c bewegt")
    expect(page.locator("#motion")).to_contain_text("2 Messfahrten von joint_1 in 2 Stellungen")
    expect(page.locator("#axes td.number").first).to_have_text("0,00\u00b0")
    look(page)
    page.get_by_role("button", name="Start").click()
    expect(page.locator("#campaign-state")).to_have_text("l\u00e4uft")
    expect(page.locator("#intent")).to_contain_text("Die Maschine bewegt sich: Messreihe 1 l\u00e4uft")
    look(page)
    until(lambda: not machine.stands(), "an axis with energy")
    page.get_by_role("button", name="STOP").click()
    expect(page.locator("#held-by")).to_have_text("Gestoppt von Bedienseite: STOP-Taste")
    until(machine.stands, "standing axes")
    expect(page.locator("#campaign-state")).to_have_text("unterbrochen")
    expect(page.locator("#cause")).to_have_text("gestoppt von Bedienseite: STOP-Taste")
    expect(page.locator("#way-out li")).to_contain_text(
        ["Maschine pr\u00fcfen", "Stopp mit Ihrem Namen freigeben", "fortsetzen"]
    )
    look(page)
    with ServiceClient(service.url) as client:  # what is stored of it is the same in each language
        assert [(stop["by"], stop["why"]) for stop in client.stops()] == [("operator page", "stop button")]
    page.get_by_label("Ihr Name").fill("Ada")
    page.get_by_role("button", name="freigeben").click()
    expect(page.locator("#held")).to_be_hidden()
    expect(page.locator("#campaign-state")).to_have_text("unterbrochen")
    assert machine.stands()
    page.get_by_role("button", name="Abbrechen").click()
    expect(page.locator("#abort-question")).to_contain_text("Messreihe 1 endg\u00fcltig abbrechen?")


def test_the_language_changes_while_a_campaign_runs_and_is_remembered(
    machine: VirtualMachine, service: Service, page: Page
) -> None:
    with ServiceClient(service.url) as client:
        campaign = int(client.add_campaign(add_plan(client, axes=["joint_1"], poses=2))["id"])
        client.start(campaign)
        until(lambda: not machine.stands(), "an axis with energy")
        expect(page.locator("#intent")).to_contain_text("Die Maschine bewegt sich")
        page.locator("#language").select_option("en")
        expect(page.locator("#intent")).to_contain_text("The machine moves: Campaign 1 runs")
        expect(page.locator("html")).to_have_attribute("lang", "en")
        expect(page.locator("#campaign-state")).to_have_text("running")
        expect(page.get_by_role("button", name="Abort", exact=True)).to_be_visible()
        assert client.campaign(campaign)["state"] == "running"
        page.keyboard.press("F8")
        until(machine.stands, "standing axes")
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
    expect(page.locator("#new-title")).to_have_text("Gemessene Messreihen diagnostizieren")
    expect(page).to_have_title("sweepid Diagnose")
    expect(page.locator("#model option")).to_have_text(["keine"])
    look(page)


def test_a_language_that_there_is_not_is_english() -> None:
    with scripted() as service, browsing(service.url, locale="fr-FR") as page:
        expect(page.locator("#machine")).to_have_text("all axes stand without energy")
        expect(page.locator("#language")).to_have_value("en")


@pytest.mark.parametrize(
    ("locale", "language", "number", "date"),
    [
        ("en-GB", "en", "2.5", "2 Mar 2026"),
        ("en-US", "en", "2.5", "Mar 2, 2026"),
        ("de-DE", "de", "2,5", "02.03.2026"),
        ("de-CH", "de", "2.5", "02.03.2026"),
    ],
)
def test_dates_and_decimal_signs_are_those_of_the_country(locale: str, language: str, number: str, date: str) -> None:
    """English is not American, and Switzerland writes a decimal point."""
    with scripted() as service, browsing(service.url, locale=locale) as page:
        expect(page.locator("html")).to_have_attribute("lang", language)
        told = page.evaluate(
            """async () => {
              const words = await import("./words.js");
              return [words.figures(2.5, 3), words.moment("2026-03-02T12:00:00Z"), words.separators()[0]];
            }"""
        )
        assert (told[0], date in told[1], told[2]) == (number, True, number[1]), told
