"""The head of a page shows the service's statement; a pause by a fault says what happened and the way on."""

import pytest
from playwright.sync_api import BrowserContext, Page, expect

from tests.browser.browsing import window
from tests.browser.looking import cut, faint, green, settled, small, too_wide
from tests.browser.scripted import HELD, JOINTS, Json, Scripted, axis, campaign, cause, drives, scripted, statement
from tests.programs import needs
from tests.system.rest_bench import until

pytestmark = needs("chromium")
RAW = "TargetNotReached: joint_2 (node 2): +0.0026 rad from its target -0.53232 rad"
TARGET = cause("target_not_reached", joint="joint_2", value=0.0026, limit=0.002, unit="rad", detail=RAW)
SILENCE = "The service does not answer. Assume that the machine moves: use the emergency stop."
MODEL: Json = {
    "id": 1, "robot_id": 1, "revision": 1, "parent": None, "diagnosis_id": 4, "accepted_by": "Ada",
    "at": "2026-03-02T12:00:00Z",
    "document": {"axes": {"joint_1": {"effects": [{"effect": "coulomb_friction"}], "fit": {}}}},
}  # fmt: skip


FAULT = {"code": 0x2310, "text": "2310h overcurrent", "emergency_stop": False}


def of_paused(why: Json, *held: Json) -> dict[str, Json]:
    """Answers with one paused campaign, and the stops that hold the machine."""
    one = campaign(structured_cause=why)
    stop: Json = {"latched": bool(held), "stop": None, "stops": held, "port": None, "process_trouble": ""}
    return {"campaigns": {"items": [one], "next": None}, "campaigns/1": one, "stop": stop | {"statement": statement()}}


def opened(context: BrowserContext, service: Scripted, path: str = "") -> Page:
    page = context.new_page()
    page.goto(f"{service.url}/{path}", wait_until="commit")
    return page


@pytest.mark.parametrize(
    ("stated", "shown", "is_green"),
    [
        (statement(), "all axes stand without energy", True),
        (statement("energised", joint_1="energised"), "with energy: joint_1", True),
        (statement("moves", joint_1="moves", joint_2="moves"), "the machine moves", True),
        (statement("unknown", joint_2="unknown"), "state not known: joint_2", False),
        (statement("unknown", "no report for 2.1 s"), "the state of the axes is not known", False),
    ],
)
def test_the_state_that_is_shown_is_the_statement(stated: Json, shown: str, is_green: bool) -> None:
    with scripted(answers={"drives": drives(statement=stated)}) as service, window() as context:
        page = opened(context, service)
        expect(page.locator("#machine")).to_have_text(shown)
        if not is_green:
            assert green(page) == []
            expect(page.locator("#intent")).to_contain_text("The state of the axes is not known.")
            expect(page.locator("#way-out")).to_contain_text("an axis may still move")
        else:
            assert ("machine" in green(page)) == (stated["state"] == "stands")
        assert (faint(page), small(page)) == ([], [])


def test_what_was_measured_too_long_ago_is_not_said() -> None:
    old = statement() | {"age": 3.1}
    with scripted(answers={"drives": drives(statement=old)}) as service, window() as context:
        service.answers["stop"] = service.answers["stop"] | {"statement": old}
        page = opened(context, service)
        expect(page.locator("#machine")).to_have_text("the state of the axes is not known")
        expect(page.locator("#intent")).to_contain_text("no report of the last 3 s")
        assert green(page) == []


def test_a_statement_ages_while_the_next_one_is_awaited() -> None:
    with scripted() as service, window() as context:
        page = opened(context, service)
        expect(page.locator("#machine")).to_have_text("all axes stand without energy")
        page.evaluate("""() => {
          window.read = [];
          const note = () => read.push(document.getElementById("machine").textContent);
          new MutationObserver(note).observe(document.getElementById("machine"), { childList: true });
        }""")
        service.frozen |= {"stop", "drives"}
        expect(page.locator("#silence")).to_be_visible(timeout=30_000)
        assert page.evaluate("read[0]") == "the state of the axes is not known"


def test_headline_sentence_and_plot_name_the_same_axis_at_any_moment() -> None:
    """Each tells of another instant of the machine: the newest statement decides for all."""
    steps = [
        {"kind": "travel", "axes": ["joint_2"], "target": 0.5, "seconds": 4.0},
        {"kind": "sweep", "axes": ["joint_1"], "target": None, "seconds": 9.0},
    ]
    runs = campaign(state="running", motion=steps)
    block: Json = {"joint": "joint_1", "time": [0.0, 0.1], "effort": [1.0, 2.0], "velocity": [0.0, 0.1]}
    moves = [statement("moves", **{joint: "moves"}) for joint in JOINTS]
    answers: dict[str, Json] = {"campaigns": {"items": [runs], "next": None}, "campaigns/1": runs}
    with scripted(answers=answers | {"drives": drives(statement=moves[1])}) as service, window() as context:
        service.answers["stop"] |= {"statement": moves[1]}
        page = opened(context, service)
        expect(page.locator("#intent")).to_contain_text("joint_2 travels to 28.6°, then joint_1 sweeps")
        page.evaluate("""() => {
          window.read = new Set();
          const texts = ["machine", "intent", "live-title"].map((id) => document.getElementById(id));
          const chart = document.getElementById("live-chart");
          const note = () => read.add([...texts.map((one) => one.textContent), chart.data?.[0].y[0]].join(" | "));
          for (const one of texts) new MutationObserver(note).observe(one, { childList: true, subtree: true });
        }""")
        until(lambda: service.sockets > 0, "the page wants samples")
        service.show(block)
        expect(page.locator("#live-title")).to_have_text("Last sweep: joint_1")
        for joint in (0, 1, 0):
            service.answers["stop"] = service.answers["stop"] | {"statement": moves[joint]}
            service.answers["drives"] = drives(statement=moves[joint])
            expect(page.locator("#machine")).to_have_text(f"moves: {JOINTS[joint]}")
            service.show(block)
            expect(page.locator("#live-title")).to_have_text(
                "Live: sweep of joint_1" if joint == 0 else "Last sweep: joint_1"
            )
        service.show(block | {"joint": "joint_2", "effort": [5.0, 6.0]})
        expect(page.locator("#live-title")).to_have_text("Last sweep: joint_2")
        read: list[str] = page.evaluate("[...read]")
    told = [one for one in read if one.startswith("moves: joint_1")]
    assert told
    assert all("joint_2" not in one.partition(" | Last sweep")[0] for one in told), told
    assert all(("sweep: joint_2" in one) == one.endswith("| 5") for one in read), read
    assert all("Live: sweep" not in one for one in read if one not in told), read


def test_the_table_of_axes_is_of_the_same_answer_as_the_headline() -> None:
    """Counted in answers of the drives, as a busy computer draws late."""
    moves = statement("moves", joint_1="moves")
    with scripted() as service, window() as context:
        page = opened(context, service)
        expect(page.locator("#machine")).to_have_text("all axes stand without energy")
        expect(page.locator("#axes tr")).to_have_count(2)
        page.evaluate("""() => {
          window.seen = {};
          const answers = () => performance.getEntriesByType("resource").filter((one) => one.name.endsWith("/drives"));
          for (const [id, words] of [["machine", "moves"], ["axes", "enabled"]]) {
            const here = document.getElementById(id);
            const note = () => { if (here.textContent.includes(words)) seen[id] ??= answers().length; };
            new MutationObserver(note).observe(here, { childList: true, subtree: true });
          }
        }""")
        service.answers["stop"] |= {"statement": moves}
        service.answers["drives"] = drives(statement=moves, axes=[axis("joint_1", state="enabled"), axis("joint_2")])
        expect(page.locator("#axes tr").first).to_contain_text("enabled")
        seen = page.evaluate("seen")
    assert seen["axes"] - seen["machine"] <= 1


def test_the_head_goes_on_while_a_campaign_is_not_answered() -> None:
    """The database is slow: what the drives report is asked all the same."""
    runs = campaign(state="running")
    answers: dict[str, Json] = {"campaigns": {"items": [runs], "next": None}, "campaigns/1": runs}
    with scripted(answers=answers) as service, window() as context:
        page = opened(context, service)
        expect(page.locator("#campaign-state")).to_have_class("badge running")
        service.frozen.add("campaigns/1")
        asked = service.requests["campaigns/1"]
        until(lambda: service.requests["campaigns/1"] > asked, "the campaign is asked for")
        before = service.requests["drives"], service.requests["stop"]
        until(lambda: service.requests["stop"] >= before[1] + 2, "the state is asked for")
        assert service.requests["drives"] <= before[0] + 1


@pytest.mark.parametrize(
    ("locale", "pill", "what", "way"),
    [
        (
            "en-US", "campaign 1 is interrupted",
            "joint_2: did not come to rest at its target in time (0.149°, limit 0.1146°)",
            ["Check joint_2", "Check what holds joint_2", "Resume campaign 1"],
        ),
        (
            "de-DE", "Messreihe 1 ist unterbrochen",
            "joint_2: nicht rechtzeitig am Ziel zum Stillstand gekommen (0,149°, Grenze 0,1146°)",
            ["joint_2 prüfen", "Prüfen, was joint_2 hält", "Messreihe 1 fortsetzen"],
        ),
    ],
)  # fmt: skip
def test_a_pause_by_a_fault(locale: str, pill: str, what: str, way: list[str]) -> None:
    paused = campaign(cause=RAW, structured_cause=TARGET)
    answers: dict[str, Json] = {"campaigns": {"items": [paused], "next": None}, "campaigns/1": paused}
    with scripted(answers=answers) as service, window(locale) as context:
        page = opened(context, service)
        expect(page.locator("#machine")).to_have_text(pill)
        expect(page.locator("#stated")).to_have_text(
            "alle Achsen stehen ohne Energie" if locale == "de-DE" else "all axes stand without energy"
        )
        expect(page.locator("#intent")).to_contain_text(what)
        expect(page.locator("#intent")).not_to_contain_text("rad")
        expect(page.locator("#way-out li")).to_contain_text(way)
        expect(page.locator("#cause")).to_be_empty()
        told = page.locator("#way-out")
        expect(told.locator("summary + *")).to_be_hidden()
        told.locator("summary").click()
        expect(told.locator("summary + *")).to_have_text(RAW)
        badge = page.locator("#campaign-state").evaluate("one => getComputedStyle(one).backgroundColor")
        assert badge in ("rgb(185, 14, 42)", "rgb(255, 138, 149)")
        assert green(page) == []
        for width in (768, 1920):
            page.set_viewport_size({"width": width, "height": 1000})
            settled(page)
            assert (faint(page), small(page), cut(page), too_wide(page)) == ([], [], [], False), width


LOST = cause("communication_lost", joint="joint_2", detail="node 2 does not answer")


@pytest.mark.parametrize(
    ("answers", "place", "what"),
    [
        (of_paused(TARGET), "#intent", "did not come to rest"),
        (
            of_paused(TARGET) | {"drives": drives(axes=[axis("joint_2", state="fault", fault=FAULT), axis("joint_1")])},
            "#intent",
            "did not come to rest",
        ),
        (of_paused(cause("stopped", by="operator page", detail="stop button"), HELD), "#held", "stop button"),
        (
            of_paused(cause("host_gap"), HELD | {"cause": cause("host_gap")}),
            "#held",
            "the computer of the service stood still",
        ),
        (of_paused(TARGET, HELD), "#intent", "did not come to rest"),
        (
            of_paused(LOST)
            | {"drives": drives(connected=False, trouble_cause=LOST, axes=[], statement=statement("unknown", "lost"))},
            "#machine",
            "the drive does not answer",
        ),
    ],
    ids=["pause", "fault", "stop", "watch", "stop after a pause", "lost"],
)
def test_a_cause_is_told_once_and_what_to_do_follows(answers: dict[str, Json], place: str, what: str) -> None:
    with scripted(answers=answers) as service, window() as context:
        page = opened(context, service)
        page.set_viewport_size({"width": 1280, "height": 800})
        expect(page.locator(place)).to_contain_text(what)
        expect(page.locator("#campaign-state")).to_have_text("paused")
        expect(page.locator("#way-out li").first).to_be_in_viewport()
        settled(page)
        assert page.locator("body").inner_text().count(what) == 1


@pytest.mark.parametrize(
    ("structured", "what"),
    [
        (cause("drive_fault", joint="joint_1", value=0x2310, unit="hex"), "joint_1: the drive reports a fault (2310h)"),
        (cause("internal"), "machine: an error of the service ended the motion"),
        (cause("sign_of_life", limit=2.0, unit="s"), "no sign of life of a person (limit 2 s)"),
        (
            cause("envelope_left", joint="joint_2", value=-0.53232, limit=-0.532319, unit="rad"),
            "joint_2: outside its limits (-30.4997°, limit -30.4996°)",
        ),
        (cause("stopped", by="operator page", detail="stop button"), "stopped by operator page: stop button"),
    ],
)
def test_what_happened_is_told_in_the_words_of_the_page(structured: Json, what: str) -> None:
    paused = campaign(structured_cause=structured)
    answers: dict[str, Json] = {"campaigns": {"items": [paused], "next": None}, "campaigns/1": paused}
    with scripted(answers=answers) as service, window() as context:
        expect(opened(context, service).locator("#intent")).to_contain_text(f"is paused ({what})")


@pytest.mark.parametrize("states", [("paused", "planned"), ("planned", "aborted")])
def test_the_campaign_that_matters_is_shown_first(states: tuple[str, str]) -> None:
    """A newer one hides neither a paused one nor what can be started."""
    made = [campaign(number, state=state) for number, state in enumerate(states, start=1)]
    answers: dict[str, Json] = {"campaigns": {"items": made, "next": None}}
    answers |= {f"campaigns/{one['id']}": one for one in made}
    with scripted(answers=answers) as service, window() as context:
        page = opened(context, service)
        expect(page.locator("#campaigns option")).to_have_count(2)
        expect(page.locator("#campaigns")).to_have_value("1")


def test_drives_that_are_late_are_no_silence_of_the_service() -> None:
    """A busy service: what it says of the stop needs neither login nor database nor drives."""
    with scripted() as service, window() as context:
        page = opened(context, service)
        expect(page.locator("#machine")).to_have_text("all axes stand without energy")
        stop = service.answers["stop"]
        service.frozen.add("drives")
        expect(page.locator("#machine")).to_have_text("the service is late: the values of the axes are old")
        for state, told in (("moves", "moves: joint_1"), ("unknown", "state not known: joint_1")):
            service.answers["stop"] = stop | {"statement": statement(state, joint_1=state)}
            expect(page.locator("#stated")).to_have_text(told)
        expect(page.locator("#intent")).to_contain_text("The state of the axes is not known.")
        assert green(page) == []
        expect(page.locator("#silence")).to_be_hidden()
        service.frozen.add("stop")
        expect(page.locator("#silence")).to_have_text(SILENCE)


def test_the_results_show_the_revisions_of_the_model() -> None:
    done = campaign(state="completed")
    answers: dict[str, Json] = {
        "campaigns": {"items": [done], "next": None}, "campaigns/1": done, "models": {"items": [MODEL], "next": None},
        "campaigns/1/estimates/convergence": {"wanted": None, "revisions": []},
    }  # fmt: skip
    with scripted(answers=answers) as service, window("en-GB") as context:
        page = opened(context, service, "results")
        expect(page.locator("#models")).to_contain_text("joint_1: Coulomb friction")
        expect(page.locator("#models")).to_contain_text("2 Mar 2026")
        expect(page.locator("#error")).to_be_hidden()


def test_the_audit_says_why_it_stopped_in_the_words_of_the_page() -> None:
    stopped = {"event": "stop", "at": "2026-03-02T12:00:00Z", "by": "campaign 1", "why": RAW}
    stopped |= {"code": "target_not_reached", "joint": "joint_2"}
    audit: Json = {"items": [{"entry": stopped}] * 200, "next": None}
    with scripted(answers={"audit": audit}) as service, window("de-DE") as context:
        page = opened(context, service, "results")
        outcome = page.locator("#audit tbody td:last-child").first
        expect(outcome).to_contain_text("joint_2: nicht rechtzeitig am Ziel zum Stillstand gekommen")
        outcome.locator("summary").click()
        expect(outcome).to_contain_text(RAW)
        box = page.locator(".scroll", has=page.locator("#audit")).bounding_box()
        assert box is not None
        assert box["height"] < 400  # it scrolls by itself


def test_the_joints_are_those_of_the_service() -> None:
    with scripted() as service, window() as context:
        page = opened(context, service)
        expect(page.locator("#axes tr td:first-child")).to_have_text([*JOINTS])
        until(lambda: service.streams == 1, "the events")


def test_an_answer_that_came_while_the_page_drew_is_not_late() -> None:
    """A plan with its chart keeps a page of a busy computer from everything else for longer than its patience."""
    with scripted() as service, window() as context:
        page = opened(context, service)
        silent = page.evaluate(
            """async () => {
              const { get } = await import("./api.js");
              const answer = get("/stop", 300).then(() => false, () => true);
              await new Promise((sent) => setTimeout(sent, 0));
              const began = performance.now();
              while (performance.now() - began < 2000);
              return answer;
            }"""
        )
        assert not silent


def test_a_plan_that_is_computed_beside_five_pages_is_no_silence() -> None:
    """It holds one connection of the browser; five for events left none for what the pages ask."""
    with scripted() as service, window() as context:
        pages = [opened(context, service, path) for path in ("plan", "", "results", "diagnosis", "fleet")]
        for page in pages:
            expect(page.locator("#machine")).to_have_text("all axes stand without energy")
        service.frozen.add("plans")
        pages[0].evaluate("void fetch('api/v1/plans', { method: 'POST' })")
        until(lambda: service.requests["plans"] == 1, "the plan is computed")
        before = service.requests["stop"]
        until(lambda: service.requests["stop"] > before + 3, "the pages ask on")
        for page in pages:
            expect(page.locator("#silence")).to_be_hidden()
