"""Each view in its main states is as the stored one, accessible, and fits: what it says, its controls, its alarms.

The tree that a screen reader gets, not pixels: those differ with the fonts and the load of a computer. What is red or
amber, in light or dark, is listed under it, so that none appears unseen. To renew: delete a state's file, run its test.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from playwright.sync_api import Page, expect

from tests.browser.accessible import both_schemes
from tests.browser.browsing import window
from tests.browser.looking import alarms, cut, faint, settled, small, too_wide
from tests.browser.scripted import HELD, Json, axis, campaign, cause, drives, scripted, statement
from tests.browser.test_german import everything
from tests.programs import needs
from tests.system.rest_bench import until

pytestmark = needs("chromium")
STORED = Path(__file__).parent / "views"
MOVES = statement("moves", joint_1="moves")
RUNS = campaign(
    state="running",
    motion=[
        {"kind": "travel", "axes": ["joint_1"], "target": 0.5, "seconds": 4.0},
        {"kind": "sweep", "axes": ["joint_2"], "target": None, "seconds": 9.0},
    ],
    progress={"done": 1, "total": 4, "remaining": 90.0, "repeat": 0.0, "pace": 1.0, "current": 2},
)
SIX = [axis(f"joint_{number}") for number in range(1, 7)]
FILLED = everything(Path(__file__).parents[2])
_REQUEST = FILLED["plans/1"]["document"]["request"] | {"kind": "trajectory", "trajectories": 1}
PAIR: Json = {name: FILLED[name] for name in ("campaigns/1/ahead", "robots", "robots/2", "cells", "machines")} | {
    "campaigns/1/sweeps": [{"state": "planned"}],
    "plans/1": FILLED["plans/1"]
    | {"document": FILLED["plans/1"]["document"] | {"request": _REQUEST, "payload_std": [0.07]}},
}  # of a plan of trajectories
FAULT = {"code": 0x2310, "text": "2310h overcurrent", "emergency_stop": False}


def of(one: Json, **more: Json) -> dict[str, Json]:
    """Answers with one campaign."""
    return {"campaigns": {"items": [one], "next": None}, "campaigns/1": one} | more


# by name: the page, its answers, and what says that it is drawn
STATES: dict[str, tuple[str, dict[str, Json], str]] = {
    "operator-rest": ("", {}, "all axes stand without energy"),
    "operator-planned": ("", of(campaign(state="planned")), "all axes stand without energy"),
    "operator-running": ("", of(RUNS, drives=drives(statement=MOVES, axes=SIX)), "moves: joint_1"),
    "operator-fault": (
        "",
        of(
            campaign(structured_cause=cause("drive_fault", joint="joint_1", value=0x2310, unit="hex")),
            drives=drives(axes=[axis("joint_1", state="fault", fault=FAULT), axis("joint_2")]),
        ),
        "fault",
    ),
    "operator-stopped": (
        "",
        of(
            campaign(structured_cause=cause("stopped", by="operator page", detail="stop button")),
            stop={
                "latched": True,
                "stop": None,
                "stops": [HELD],
                "port": None,
                "process_trouble": "",
            },
        ),
        "stopped",
    ),
    "operator-check-move": (
        "",
        of(
            campaign(state="running", check_move={"axis": "joint_2", "way": -0.0087266, "unit": "rad"}),
            drives=drives(statement=statement("moves", joint_2="moves")),
        ),
        "moves: joint_2",
    ),
    "operator-abort": ("", of(campaign()), "all axes stand without energy"),
    "operator-login": ("", {}, "nobody is logged in"),
    "operator-silent": ("", of(RUNS), "all axes stand without energy"),
    "operator-unknown": ("", {"drives": drives(statement=statement("unknown", joint_2="unknown"))}, "not known"),
    "operator-disconnected": ("", {"drives": drives(connected=False, trouble="no bus", axes=[])}, "no bus"),
    "plan": ("plan", {}, "all axes stand without energy"),
    "payload": ("payload", PAIR, "all axes stand without energy"),
    "payload-planned": ("payload", of(campaign(state="planned", plan_id=1), **PAIR), "all axes stand without energy"),
    "payload-mount": ("payload", of(campaign(state="completed", plan_id=1), **PAIR), "all axes stand without energy"),
    "results": ("results", {}, "all axes stand without energy"),
    "diagnosis": ("diagnosis", {}, "all axes stand without energy"),
    "fleet": ("fleet", {}, "all axes stand without energy"),
    "operator-filled": ("#campaign-1", FILLED, "all axes stand without energy"),
    "payload-filled": ("payload#3", FILLED, "all axes stand without energy"),
    "results-filled": ("results#campaign-1", FILLED, "all axes stand without energy"),
    "diagnosis-filled": ("diagnosis#1", FILLED, "all axes stand without energy"),
    "fleet-filled": ("fleet", FILLED, "all axes stand without energy"),
}


def seen(page: Page) -> str:
    """The tree of the page and what is painted in the colours of warnings and alarms."""
    settled(page)
    return "\n".join([page.locator("body").aria_snapshot(), *(f"alarm: {one}" for one in alarms(page)), ""])


def matches(page: Page, name: str) -> None:
    """Raises AssertionError if the page does not come to look as stored, within 10 s."""
    path = STORED / f"{name}.txt"
    stored = path.read_text("utf-8") if path.exists() else None
    now = ""
    for _ in range(40):  # the answers at the start come in any order
        page.wait_for_timeout(250)
        if (now := seen(page)) == stored:
            return
    if stored is None:
        path.write_text(now, "utf-8")
    assert stored == now, f"{path}: written anew if it was missing; look at it"


@contextmanager
def opened(name: str, locale: str) -> Iterator[Page]:
    """A view in one of its states."""
    path, answers, drawn = STATES[name]
    with scripted(answers=answers) as service, window(locale) as context:
        service.answers["stop"] |= {"statement": service.answers["drives"]["statement"]}
        service.known = set() if name == "operator-login" else None
        page = context.new_page()
        page.goto(f"{service.url}/{path}", wait_until="commit")
        expect(page.locator("#machine")).not_to_be_empty()
        if locale == "en-GB":
            expect(page.locator("#machine")).to_contain_text(drawn)
        if name == "operator-silent":
            expect(page.locator("#live")).to_be_visible()
            expect(page.locator("#axes tr")).to_have_count(2)
            service.frozen.update(("stop", "drives"))
            expect(page.locator("#silence")).to_be_visible(timeout=15_000)
        if name == "operator-abort":
            page.locator("#abort").click()
            expect(page.locator("#abort-question")).to_be_visible()
        yield page


@pytest.mark.parametrize("locale", ["en-GB", "de-DE"])
@pytest.mark.parametrize("name", STATES)
def test_a_view_is_the_stored_one(name: str, locale: str) -> None:
    with opened(name, locale) as page:
        matches(page, f"{name}-{locale[:2]}")
        expect(page.locator("#error")).to_be_hidden()  # of no state: an error is not stored either
        assert both_schemes(page) == []
        matches(page, f"{name}-{locale[:2]}")  # in dark, the last
        page.emulate_media(color_scheme="light")
        for width in (768, 1280, 1920):
            page.set_viewport_size({"width": width, "height": 800})
            page.mouse.wheel(0, 2000)
            settled(page)
            for shown in (page.locator("#stop"), *page.locator(".banner:visible").all()):
                expect(shown).to_be_in_viewport()  # however far it is scrolled
            assert (faint(page), small(page), too_wide(page)) == ([], [], False), width
            until(lambda: not cut(page), f"nothing is cut at {width} px", 10.0)  # charts follow their panel late


@pytest.mark.parametrize("locale", ["en-GB", "de-DE"])
def test_what_moves_what_follows_and_stop_are_on_one_screen(locale: str) -> None:
    with opened("operator-running", locale) as page:
        page.set_viewport_size({"width": 1280, "height": 800})
        matches(page, f"operator-running-{locale[:2]}")
        for seen in ("#intent", "#stop", "#pause", "#abort", "#progress-text", "#axes", "#live-chart"):
            box = page.locator(seen).bounding_box()
            assert box is not None, seen
            assert box["y"] + box["height"] <= 800, (seen, box)
        boxes = [page.locator(f"#{name}").bounding_box() for name in ("pause", "abort")]
        pause, abort = (one for one in boxes if one is not None)
        assert min(pause["height"], abort["height"]) >= 56
        assert min(pause["width"], abort["width"]) >= 120
        assert abort["x"] - pause["x"] >= 2 * pause["width"]  # away from what is pressed often


@pytest.mark.parametrize(
    "plant",
    [
        "document.querySelector('main').prepend(Object.assign(document.createElement('p'), "
        "{className: 'banner', textContent: 'Overheated'}))",
        "document.querySelector('main').append(Object.assign(document.createElement('p'), "
        "{className: 'state bad', textContent: 'stands'}))",  # no script draws it again
        "document.querySelector('main h2').style.background = '#a00000'",
        "document.querySelector('main').style.background = '#c8102e'",
        "document.querySelector('main').append(Object.assign(document.createElement('hr'), {className: 'banner'}))",
    ],
    ids=["banner", "text", "ground", "frame", "wordless"],
)
def test_a_planted_red_is_seen(plant: str) -> None:
    with opened("operator-rest", "en-GB") as page:
        matches(page, "operator-rest-en")
        page.evaluate(plant)
        stored = (STORED / "operator-rest-en.txt").read_text("utf-8").splitlines()
        new = [line for line in seen(page).splitlines() if line not in stored]
        assert any(line.startswith("alarm: ") for line in new), new
