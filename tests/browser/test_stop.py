"""STOP leaves the browser however many pages are open, and the page says what became of it within 1 s."""

import pytest
from playwright.sync_api import BrowserContext, Page, expect

from tests.browser.browsing import window
from tests.browser.looking import faint, green, small
from tests.browser.scripted import HELD, JOINTS, Json, Scripted, campaign, scripted
from tests.programs import needs
from tests.system.rest_bench import until

pytestmark = needs("chromium")
PAGES = ("", "plan", "results", "diagnosis", "fleet", "")
SAID = 1_500  # ms: 1 s, and what this computer needs to draw
NOT_LEFT = "STOP DID NOT LEAVE THIS BROWSER: use the emergency stop."
LATE = "STOP SENT, NOT CONFIRMED WITHIN 1 s: use the emergency stop."
CONFIRMED = "STOP confirmed: all axes stand without energy."
UNCONFIRMED: Json = {
    "type": "urn:sweepid:problem:stop-not-confirmed", "title": "Service Unavailable", "status": 503,
    "detail": "stop sent, not confirmed within 1 s: joint_2: does not answer; use the emergency stop",
    "sent": [*JOINTS], "confirmed": ["joint_1"], "unconfirmed": {"joint_2": "does not answer"},
}  # fmt: skip


def opened(context: BrowserContext, service: Scripted, path: str = "") -> Page:
    page = context.new_page()
    page.goto(f"{service.url}/{path}", wait_until="commit")
    expect(page.locator("#machine")).to_have_text("all axes stand without energy")
    return page


def moving() -> dict[str, Json]:
    """A campaign runs: the first page also holds a connection for its live samples."""
    running = campaign(state="running", motion=[{"kind": "sweep", "axes": ["joint_1"], "target": None, "seconds": 9.0}])
    return {"campaigns": {"items": [running], "next": None}, "campaigns/1": running}


WITHOUT_WORKERS = "delete globalThis.SharedWorker"


@pytest.mark.parametrize("script", ["", WITHOUT_WORKERS], ids=["shared worker", "leader"])
@pytest.mark.parametrize("stop_port", ["none", "blocked", "open"])
def test_stop_leaves_a_browser_with_six_pages_open(stop_port: str, script: str) -> None:
    """Over HTTP/1.1 a browser has six connections to a host."""
    with scripted(stop_port, answers=moving()) as service, window(script=script) as context:
        pages = [opened(context, service, path) for path in PAGES]
        until(lambda: service.streams == 1, "one connection for the events of all pages")
        until(lambda: service.sockets == 2, "live samples on both pages that show them")
        pages[-1].get_by_role("button", name="STOP").click()
        expect(pages[-1].locator("#stop-told")).to_have_text(CONFIRMED, timeout=SAID)
        ways = {path for path, _ in service.stops}
        assert ways == ({"/api/v1/stop", "/stop"} if stop_port == "open" else {"/api/v1/stop"})
        assert len({query["press"] for _, query in service.stops}) == 1


def test_behind_a_proxy_stop_goes_to_both_processes_as_one_press() -> None:
    with scripted("blocked", behind_proxy=True) as service, window() as context:
        service.frozen.add("/api/v1/stop")
        pages = [opened(context, service, path) for path in PAGES]
        pages[0].keyboard.press("F8")
        expect(pages[0].locator("#stop-told")).to_have_text(CONFIRMED, timeout=SAID)  # by the stop process
        assert sorted(path for path, _ in service.stops) == ["/api/v1/stop", "/stop"]
        assert len({query["press"] for _, query in service.stops}) == 1


# Chromium sends a GET while an equal one waits only after 20 s, unless both bypass its cache
HOLD = "() => { for (let k = 0; k < 6; k += 1) fetch('api/v1/held', { cache: 'no-store' }).catch(() => {}); }"


def test_a_stop_that_does_not_leave_the_browser_is_said_in_red_within_a_second() -> None:
    """Whatever holds the six connections."""
    with scripted("blocked") as service, window() as context:
        page = opened(context, service)
        other = opened(context, service, "plan")
        service.frozen.add("held")
        other.evaluate(HOLD)
        until(lambda: service.requests["held"] >= 5, "connections that are held")
        page.get_by_role("button", name="STOP").click()
        told = page.locator("#stop-told")
        expect(told).to_have_text(NOT_LEFT, timeout=SAID)
        assert told.evaluate("one => getComputedStyle(one).backgroundColor") == "rgb(200, 16, 46)"
        assert (service.stops, faint(page)) == ([], [])
        other.close()  # a connection is free: it leaves now, and the page says so
        expect(told).to_have_text(CONFIRMED)
        assert [path for path, _ in service.stops] == ["/api/v1/stop"]


def test_a_stop_without_network_did_not_leave() -> None:
    with scripted("blocked") as service, window() as context:
        page = opened(context, service)
        context.set_offline(True)
        page.get_by_role("button", name="STOP").click()
        expect(page.locator("#stop-told")).to_have_text(NOT_LEFT, timeout=SAID)


def test_a_service_that_hangs_has_the_stop_and_did_not_confirm_it() -> None:
    with scripted("blocked") as service, window() as context:
        page = opened(context, service)
        service.frozen.add("/api/v1/stop")
        page.get_by_role("button", name="STOP").click()
        expect(page.locator("#stop-told")).to_have_text(LATE, timeout=SAID)
        assert green(page) == []


@pytest.mark.parametrize(
    ("locale", "words"),
    [
        ("en-US", "STOP NOT CONFIRMED WITHIN 1 s: use the emergency stop. Not confirmed: joint_2: does not answer"),
        ("de-DE", "STOP NICHT INNERHALB 1 s BESTÄTIGT: Not-Halt betätigen. Nicht bestätigt: joint_2: does not answer"),
    ],
)
def test_the_axes_that_did_not_confirm_are_named(locale: str, words: str) -> None:
    with scripted("open") as service, window(locale) as context:
        service.stop = (503, UNCONFIRMED)
        page = context.new_page()
        page.goto(service.url, wait_until="commit")
        expect(page.locator("#axes tr")).to_have_count(2)
        page.get_by_role("button", name="STOP").click()
        expect(page.locator("#stop-told")).to_have_text(words, timeout=SAID)
        assert green(page) == []


def test_sent_is_not_confirmed() -> None:
    """202: the drives were told, nobody knows yet what they do."""
    with scripted("open") as service, window() as context:
        service.stop = (202, {"sent": [*JOINTS], "confirmed": [], "unconfirmed": dict.fromkeys(JOINTS, "moves")})
        page = opened(context, service)
        page.get_by_role("button", name="STOP").click()
        expect(page.locator("#stop-told")).to_contain_text("STOP NOT CONFIRMED WITHIN 1 s", timeout=SAID)


def test_what_was_said_of_a_stop_goes_with_its_release() -> None:
    with scripted() as service, window() as context:
        page = opened(context, service)
        free = service.answers["stop"]
        service.answers["stop"] = free | {"latched": True, "stops": [HELD]}
        page.get_by_role("button", name="STOP").click()
        expect(page.locator("#stop-told")).to_have_text(CONFIRMED)
        expect(page.locator("#machine")).to_have_text("stopped")
        expect(page.locator("#stated")).to_have_text("all axes stand without energy")
        assert green(page) == []
        service.answers["stop"] = free
        expect(page.locator("#stop-told")).to_be_hidden()


def test_a_name_that_was_typed_once_releases_with_one_press() -> None:
    """With gloves; each of the names of this browser has a button, and only the displayed stops are released."""
    with scripted() as service, window() as context:
        free = service.answers["stop"]
        for name, known in (("Ada", []), ("Grace", ["Ada"]), ("Grace", ["Grace", "Ada"])):
            service.answers["stop"] = free
            page = opened(context, service)
            service.answers["stop"] = free | {"latched": True, "stops": [HELD]}
            expect(page.locator("#held")).to_be_visible()
            offered = page.locator("#release-as button")
            expect(offered).to_have_text([f"Machine checked: release as {one}" for one in known])
            with page.expect_request("**/stop/reset") as sent:
                if name in known:
                    assert small(page) == []
                    offered.first.click()
                else:
                    page.locator("#reset-by").fill(name)
                    page.locator("#held > button").click()
            assert sent.value.post_data_json == {"by": name, "stops": [7]}
            page.close()


@pytest.mark.parametrize(
    ("answer", "shown"),
    [
        ((200, {"confirmed": [*JOINTS]}), '"confirmed"'),
        ((503, UNCONFIRMED), "not confirmed within 1 s: joint_2: does not"),
    ],
)
@pytest.mark.parametrize("script", ["*", "app", "words", "texts"])
def test_a_page_without_its_scripts_says_so_and_its_stop_shows_the_answer(
    answer: tuple[int, Json], shown: str, script: str
) -> None:
    with scripted() as service, window() as context:
        service.stop = answer
        page = context.new_page()
        page.route(f"**/{script}.js", lambda route: route.abort())
        page.goto(service.url, wait_until="commit")
        dead = page.locator("#dead")
        expect(dead).to_contain_text("This page has not loaded")
        expect(dead).to_contain_text("Diese Seite ist nicht geladen")
        page.get_by_role("button", name="STOP").click()
        expect(page.locator("body")).to_contain_text(shown)
        assert [(query["by"], query["why"]) for _, query in service.stops] == [("operator page", "stop button")]


def test_the_stop_does_not_wait_for_the_charts() -> None:
    with scripted() as service, window() as context:
        context.route("**/plotly.min.js", lambda route: None)  # never answered
        page = opened(context, service)
        page.get_by_role("button", name="STOP").click()
        expect(page.locator("#stop-told")).to_have_text(CONFIRMED)
        expect(page.locator("#dead")).to_be_hidden()


# -- the one connection for events


def log_in(page: Page, service: Scripted, key: str) -> None:
    page.goto(service.url, wait_until="commit")
    page.get_by_label("Your key").fill(key)
    page.get_by_role("button", name="Log in").click()
    expect(page.locator("#machine")).to_have_text("all axes stand without energy")


KEYS = tuple(f"sweepid-{digit * 64}" for digit in "12")


@pytest.mark.parametrize("script", ["", WITHOUT_WORKERS], ids=["shared worker", "leader"])
def test_a_login_that_ends_does_not_end_the_events_of_others(script: str) -> None:
    with scripted() as service, window(script=script) as context:
        service.known = {*KEYS}
        pages = [context.new_page(), context.new_page()]
        for page, key in zip(pages, KEYS, strict=True):
            log_in(page, service, key)
        until(lambda: service.streams == 1, "one connection")
        assert service.keys == [KEYS[0]]
        service.known = {KEYS[1]}  # the key of the first page was revoked
        service.cut()
        until(lambda: service.streams == 1 and service.keys[-1] == KEYS[1], "a connection with the other key")
        expect(pages[0].locator("#login")).to_be_visible()
        before = service.requests["campaigns"]
        service.tell("campaign")
        until(lambda: service.requests["campaigns"] > before, "the page that is logged in asks again")
        assert {*service.keys[2:]} <= {KEYS[1]}


@pytest.mark.parametrize("script", ["", WITHOUT_WORKERS], ids=["shared worker", "leader"])
def test_the_key_of_a_page_that_is_closed_is_not_used_any_longer(script: str) -> None:
    with scripted() as service, window(script=script) as context:
        service.known = {*KEYS}
        pages = [context.new_page(), context.new_page()]
        for page, key in zip(pages, KEYS, strict=True):
            log_in(page, service, key)
        pages[0].close()
        until(lambda: service.streams == 1 and service.keys == [*KEYS], "a connection with the key of who is there")


def test_a_page_gets_the_kinds_of_events_alone() -> None:
    """No key and no content of an event comes to a page by the worker."""
    spy = """
      globalThis.heard = [];
      const before = Object.getOwnPropertyDescriptor(MessagePort.prototype, "onmessage");
      Object.defineProperty(MessagePort.prototype, "onmessage", { set(told) {
        before.set.call(this, (event) => { heard.push(event.data); told(event); });
      } });"""
    with scripted() as service, window(script=spy) as context:
        service.known = {KEYS[0]}
        page = context.new_page()
        log_in(page, service, KEYS[0])
        until(lambda: service.streams == 1, "the connection")
        service.tell("sweep")
        until(lambda: page.evaluate("heard.includes('sweep')"), "the event")
        assert page.evaluate("heard") == ["open", "sweep"]
