"""The German pages are German: no English word, no decimal point, and nothing that is marked as English (`lang`).

What is of another source is quoted, in no known language: a drive, the operating system, a file, a person.
"""

import json
import re
from itertools import pairwise
from pathlib import Path

import pytest
from playwright.sync_api import Page, expect

from service.diagnosis.law import WORDS, Law
from service.model.results.diagnosis import AxisDiagnosis
from service.report.diagnosis import figures_of
from service.web.hmi.pages import texts
from tests.browser.browsing import browsing
from tests.browser.looking import settled
from tests.browser.scripted import Json, campaign, drives, scripted
from tests.browser.sentences import sentences
from tests.programs import needs
from tests.stored.documents import axis_document, diagnosis_document, payload, stored

pytestmark = needs("chromium")

SEEN = r"""() => {
  const told = [], walk = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
  const names = ["title", "placeholder", "aria-label"];
  const left = "code, #language";
  const german = (one) => one.checkVisibility() && !one.closest("q[lang='']") && !one.closest(left);
  while (walk.nextNode()) {
    const grouped = walk.currentNode.parentElement.closest("#figure-evidence"); // whole numbers: 2.797.064
    const text = walk.currentNode.textContent.trim();
    if (german(walk.currentNode.parentElement)) told.push(grouped ? text.replace(/\.(?=\d{3}(\D|$))/g, "") : text);
  }
  for (const one of document.querySelectorAll(names.map((name) => `[${name}]`).join())) {
    if (german(one)) told.push(...names.map((name) => one.getAttribute(name) ?? ""));
  }
  return told.filter((text) => text);
}"""
WORD = re.compile(r"[A-Za-zÄÖÜäöüß]{2,}")
POINT = re.compile(r"(?<![\d.])\d+\.\d+(?![\d.])|\d,\d{3},\d{3}")  # and thousands as in English
DATE = re.compile(r"\d{2}\.\d{2}\.\d{4}")


def words(language: str) -> set[str]:
    return {
        word.lower() for text in texts()[language].values() for word in WORD.findall(re.sub(r"\{\w+\}|`.*?`", "", text))
    }


OUTSIDE = {"drive", "system", "file", "person"}
ENGLISH = words("en") - words("de")


def english(told: list[str]) -> set[str]:
    """Words of the English catalogue alone, and numbers with a decimal point; names of joints and dates are neither."""
    found: set[str] = set()
    for text in told:
        found |= {word for word in WORD.findall(re.sub(r"\b\w+_\w+\b", "", text)) if word.lower() in ENGLISH}
        found |= set(POINT.findall(DATE.sub("", text)))
    return found


def test_the_looking_finds_an_english_word_and_number() -> None:
    told = ["Axis joint_1 with 2.5 kg", "02.03.2026", "2,5 kg", "Achse", "2,797,064", "2.797.064"]
    assert english(told) == {"Axis", "with", "2.5", "2,797,064"}


def of_diagnosis(axis: Json) -> dict[str, Json]:
    """One finished diagnosis of an axis."""
    entry: Json = {
        "id": 1, "machine": "M1", "here": True, "robot_id": 1, "campaigns": [1], "axes": ["joint_1"], "model": None,
        "estimate": None, "state": "done", "cause": "", "verdicts": {"joint_1": axis["verdict"]}, "parent": None,
        "experiment": None, "weighed": None, "unattended": False, "created_at": "2026-03-02T12:00:00Z",
        "finished_at": "2026-03-02T12:01:00Z",
    }  # fmt: skip
    return {
        "campaigns": {"items": [campaign(1, state="completed", machine="M1")], "next": None},
        "diagnoses": {"items": [entry], "next": None},
        "diagnoses/1": entry | {"document": diagnosis_document(joint_1=axis)},
        "diagnoses/1/figures": {"axes": {"joint_1": {}}},
        "machines": {"items": [], "next": None, "missing": []},
    }


def everything(root: Path) -> dict[str, Json]:
    """A service with a measured, identified and diagnosed campaign: the examples of the API document, and the rest."""
    given = (root / "service/web/api/examples.json").read_text("utf-8")
    for name in (r'(?<="machine": )"machine"', r'(?<="name": )"machine"', r'"cell \d"'):  # of machines: not words
        given = re.sub(name, '"M1"', given)
    examples = json.loads(given)
    undecided = axis_document(verdict="ambiguous") | {
        "next_experiment": stored("diagnosis-open")["axes"]["joint_1"]["next_experiment"]
    }
    one = campaign(1, plan_id=1, machine="M1", data_check=stored("check"))
    return of_diagnosis(undecided) | {
        "campaigns": {"items": [one], "next": None},
        "campaigns/1": one,
        "campaigns/1/sweeps": {"items": [examples["SweepDocument"]], "next": None},
        "campaigns/1/ahead": examples["Ahead"],
        "campaigns/1/estimates/latest": {"revision": 1, "number": 2, "document": stored("estimate")},
        "campaigns/1/estimates/convergence": examples["Convergence"],
        "plans/1": examples["PlanView"],
        "plans/1/ahead": examples["Ahead"],
        "plans/1/grid": examples["PoseGrid"],
        "plans/1/picture": examples["Picture"],
        "plans": examples["PlanView"],
        "robots": {"items": [examples["RobotEntry"]], "next": None},
        "robots/2": examples["RobotDocument"],
        "cells": {"names": ["workshop"]},
        "machines": examples["Machines"],
        "drives": drives(),
        "fleet": examples["Fleet"],
        "audit": {"items": [examples["AuditDocument"]], "next": None},
        "payloads": {"items": [examples["PayloadEntry"]], "next": None},
        "payloads/3": examples["PayloadView"] | {"state": "done", "document": payload(), "no_sheet": ""},
        "models": {"items": [examples["ModelDocument"]], "next": None},
        "diagnoses/1/figures": {"axes": {"joint_1": figures_of(AxisDiagnosis.model_validate(undecided))}},
    }


def plan(page: Page) -> None:
    page.locator("#make").click()
    expect(page.locator("#planned")).to_be_visible()


@pytest.mark.parametrize(
    ("said", "told"),
    [
        ("the machine may not move: plan 3 requires the approval of an engineer: not approved yet",
         "darf sich nicht bewegen: Plan 3 braucht die Freigabe durch einen Ingenieur: noch nicht freigegeben"),
        ("node 2: no heartbeat for 1.5 s", "Knoten 2: seit 1,5 s kein Heartbeat"),
        ("the last report is 2.1 s old, limit 2 s", "die letzte Meldung ist 2,1 s alt, Grenze 2 s"),
        ("campaign 3: start is not possible in state running", "3: Starten ist im Zustand läuft nicht möglich"),
        ("reversal separates asymmetric friction, backlash and payload best for its time.",
         "Umkehr trennt für ihre Dauer am besten: richtungsabhängige Reibung, Getriebespiel (Lose) und Nutzlast."),
        ("joint_1: effort has 3 single samples off the course of those around, by up to 12.5 (sweeps 0001, 0002 "
         "and 4 more).",
         "joint_1: Drehmoment hat 3 Werte weit neben den Nachbarn, um bis zu 12,5 "
         "(Messfahrten 0001, 0002 und 4 weitere)."),
        ("joint_1: the gap is largest at position within the sweep -0.0231 to 2.19e-07 rad (48.6 against 32.4).",
         "Position in der Messfahrt -0,0231 bis 2,19e-07 rad (48,6 gegen 32,4)"),
        ("joint_2: time jumps by up to 3 samples (sweep 0004).",
         "joint_2: Die Zeit springt um bis zu 3 Abtastwerte (Messfahrt 0004)."),
        ("joint_1 (node 1): position 0.51234 rad is outside -0.5 to 0.5 rad",
         "joint_1 (Knoten 1): Position 0,51234 rad ist außerhalb von -0,5 bis 0,5 rad"),
        ("EnvelopeLeft: joint_1: effort 201.5 N m is beyond 200 N m; joint_2 (node 2): is not at standstill 2 s after "
         "its sweep",
         "joint_1: Drehmoment 201,5 N m ist jenseits von 200 N m; joint_2 (Knoten 2): steht 2 s nach der Messfahrt "
         "nicht still"),
        ("joint_1: the model lacks Coulomb friction and backlash. With them the gap (cross-validated) falls from "
         "33.6 N m (34.5 % of the effort) to 1.23 N m (1.27 % of the effort); the noise alone makes 1.14 N m. Next: "
         "measure the proposed experiment.",
         "joint_1: Dem Modell fehlt: Coulomb-Reibung und Getriebespiel (Lose). Damit sinkt die Abweichung "
         "(kreuzvalidiert) von 33,6 N m (34,5 % des Drehmoments) auf 1,23 N m (1,27 % des Drehmoments); das Rauschen "
         "allein macht 1,14 N m. Als Nächstes das vorgeschlagene Experiment messen."),
        ("bus can0: sending failed: No buffer space available",
         "Bus can0: Senden fehlgeschlagen: No buffer space available"),
        ("stands at [10.0.0.7:502], 1.5 N m, whatever that may be", None),
    ],
)  # fmt: skip
def test_a_sentence_of_the_service_is_told_in_german(said: str, told: str | None) -> None:
    """None: it is not in the catalogue, and marked as English."""
    one = drives(connected=False, trouble=said, axes=[])
    with scripted(answers={"drives": one}) as service, browsing(service.url, locale="de-DE") as page:
        expect(page.locator("#machine")).to_contain_text(told or said)
        assert page.locator("#machine [lang=en]").count() == (told is None)


PLACES = (
    *("drivers/canopen", "drivers/cia402", "drivers/modbus", "service/data_check", "service/diagnosis", "service/jobs"),
    *("service/machine/execution", "service/machine/stop_process", "service/planning", "service/web"),
    *(f"service/store/{name}.py" for name in ("lease_and_latch", "table_rows", "diagnoses", "documents")),
)
# met at the start of the service or in a command, not on a page
ELSEWHERE = (
    "its effect calls itself", "an effect of this name", "cannot be loaded:", "CatalogueEffect", "sweepid[oidc]",
    "must be the joints of", "SWEEPID_URL", "Bearer realm",
)  # fmt: skip


def test_each_sentence_of_the_source_has_its_german(root: Path) -> None:
    said = [one for one in sorted(sentences(root, *PLACES)) if not any(part in one for part in ELSEWHERE)]
    assert len(said) > 300
    with scripted() as service, browsing(service.url, locale="de-DE") as page:
        left = page.evaluate(
            """async (said) => {
              const { foreign } = await import("./words.js");
              return said.filter((one) => foreign(one).lang);
            }""",
            said,
        )
    assert left == []


def test_each_law_is_told_in_german() -> None:
    kinds = list(WORDS)
    laws = [Law((one, other), {}, 2.0, 0.5, 12, -0.3, 1.25) for one, other in pairwise([*kinds, kinds[0]])]
    said = [*(law.sentence("joint_1", "N m") for law in laws), "It tests the proposed law."]
    with scripted() as service, browsing(service.url, locale="de-DE") as page:
        told = page.evaluate(
            """async (said) => {
              const { foreign } = await import("./words.js");
              return said.map((one) => foreign(one)).map((one) => (one.lang ? "" : one.textContent));
            }""",
            said,
        )
    assert all("Abweichung" in one and "ferner: es" in one for one in told[:-1])
    assert told[-1] == "Sie prüfen das vorgeschlagene Gesetz."


def test_findings_are_told_in_german(root: Path) -> None:
    found = stored("check-wrong")["findings"]
    one = campaign(state="completed", data_check={"findings": found, "axes": {}})
    answers: dict[str, Json] = {"campaigns": {"items": [one], "next": None}, "campaigns/1": one}
    with scripted(answers=answers) as service, browsing(service.url, locale="de-DE") as page:
        expect(page.locator("#data-check")).to_contain_text("Das scheinbare Trägheitsmoment ist -300 kg m^2")
        assert page.locator("#data-check [lang=en]").count() == 0


@pytest.mark.parametrize(
    ("url", "seen"),
    [
        ("/#campaign-1", "#parameters tr"),
        ("/plan", "#axes-measured input"),
        ("/payload#3", "#body tr"),
        ("/results#campaign-1", "#table tbody tr"),
        ("/diagnosis#1", "#figure-parameters .xtitle"),
        ("/fleet", "#robots tbody tr"),
    ],
)
def test_no_english_word_and_no_decimal_point_on_a_german_page(root: Path, url: str, seen: str) -> None:
    with scripted(answers=everything(root)) as service, browsing(f"{service.url}{url}", locale="de-DE") as page:
        expect(page.locator(seen).first).to_be_visible()
        if url == "/plan":
            plan(page)
        settled(page)
        page.evaluate("for (const one of document.querySelectorAll('details')) one.open = true")
        assert english(page.evaluate(SEEN)) == set()
        assert page.locator("body [lang=en]:not(option, #dead [lang])").all_text_contents() == []
        assert (
            set(page.evaluate("[...document.querySelectorAll('[lang=\"\"]')].map((one) => one.dataset.source)"))
            <= OUTSIDE
        )
