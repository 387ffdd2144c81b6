"""A payload on the page: planned, measured without it, mounted, measured with it, computed, its sheet."""

from collections.abc import Callable
from pathlib import Path

import pytest
import yaml
from playwright.sync_api import Page, expect

from service.web.client import ServiceClient
from tests.browser.accessible import both_schemes
from tests.browser.browsing import browsing
from tests.browser.conftest import connected
from tests.browser.looking import cut, faint, settled, small, too_wide
from tests.browser.scripted import EMPTY, Json, scripted
from tests.browser.test_german import SEEN, english, everything
from tests.programs import needs
from tests.stored.documents import payload
from tests.system.rest_bench import CONFIG, VirtualMachine, release, serving, until, virtual_machine

pytestmark = needs("chromium")
MASS = 30.0  # kg
FRICTION = (
    "No mass detected: 0.31 kg, standard deviation 0.11 kg. If the torques differ, it is not a load but friction or "
    "the torque constants: warm up and record both again."
)
UNEXPLAINED = "BadInput: payload: no effort differs between the bundles: name one without the payload and one with it"


def test_from_the_plan_to_the_sheet(tmp_path: Path) -> None:
    def look(_: str) -> None:
        assert both_schemes(page) == []
        for width in (768, 1280, 1920):
            page.set_viewport_size({"width": width, "height": 1000})
            settled(page)
            assert (faint(page), small(page), cut(page), too_wide(page)) == ([], [], [], False), width

    bare = CONFIG / "scenarios" / "max100-six.yaml"
    with (
        virtual_machine(tmp_path, 4.0, scenario=bare) as machine,
        serving(tmp_path, machine.profile) as service,
        browsing(f"{service.url}/payload") as page,
        ServiceClient(service.url) as client,
    ):
        measured(page, client, machine, heavier(tmp_path, bare), look)


def heavier(folder: Path, bare: Path) -> Path:
    """The same machine with a mass on the last link."""
    scenario = yaml.safe_load(bare.read_text("utf-8")) | {"robot": str(CONFIG / "robots" / "max100-class.yaml")}
    load = {"name": "load", "mass": MASS, "start": [0.1, 0.05, 0.0], "end": [0.3, 0.05, 0.0], "radius": 0.1}
    scenario["links"]["link_6"] = {"added": [load]}
    (heavy := folder / "heavy.yaml").write_text(yaml.safe_dump(scenario), "utf-8")
    return heavy


def measured(
    page: Page, client: ServiceClient, machine: VirtualMachine, heavy: Path, look: Callable[[str], None]
) -> None:
    """As a person does it; `look` at each view."""
    now = page.locator("#steps [aria-current=step]")
    expect(page.locator("#robot option")).not_to_have_count(0)
    until(lambda: client.drives()["connected"], "the machine is connected")
    page.locator("#trajectories").fill("1")
    page.locator("#speed").fill("0.8")
    look("plan")
    page.get_by_role("button", name="Make the plan").click()
    expect(page.get_by_role("button", name="Nothing is mounted")).to_be_visible()
    expect(page.locator("#steps li").first).to_contain_text("1 motion of all axes at once")
    assert client.campaigns() == []
    look("bare")
    page.locator("#mounted").click()
    expect(page.locator("#motion li").first).to_be_visible()
    expect(page.locator("#next")).to_contain_text("press Start")
    assert machine.stands()
    look("before-start")
    page.locator("#start").click()
    expect(page.locator("#next")).to_contain_text("The machine moves, without the payload")
    look("moves")
    expect(page.get_by_role("button", name="The payload is mounted")).to_be_visible(timeout=180_000)
    assert machine.stands()
    look("mount")
    machine.power_off()
    machine.power_on(heavy)
    until(lambda: not client.drives()["connected"] or client.stops(), "the power cut is noticed")
    if client.stops():
        release(client)
    until(lambda: connected(client), "the machine is connected again")
    page.reload()  # the page goes on where the person was
    page.get_by_role("button", name="The payload is mounted").click()
    expect(now).to_contain_text("Measure with the payload")
    expect(page.locator("#motion li").first).to_be_visible()
    page.locator("#start").click()
    expect(page.locator("#error")).to_be_empty()  # a start that was refused says why
    expect(page.locator("#next")).to_contain_text("The machine moves, with the payload")
    expect(page.locator("#compute")).to_be_visible(timeout=180_000)
    assert machine.stands()
    look("compute")
    page.locator("#compute button").click()
    expect(page.locator("#body tr")).to_have_count(10)
    look("result")
    _, value, std = (page.locator("#body td").nth(k).inner_text() for k in range(3))
    assert abs(float(value) - MASS) < 5 * float(std) < 3.0
    with page.expect_download() as sheet:
        page.locator("#downloads a").click()
    assert "set_target_payload(" in sheet.value.path().read_text("utf-8")
    expect(page.locator("#payloads tr")).to_have_text("1\t1\t2\tdone", use_inner_text=True)


@pytest.mark.parametrize(
    ("sentence", "more", "told"),
    [
        (
            FRICTION,
            {"no_sheet": "payload 3 mass: is 0.31 kg, standard deviation 0.11 kg: no mass detected"},
            ["Keine Masse erkannt: 0,31 kg", "keine Last, sondern Reibung", "keine Masse erkannt."],
        ),
        (
            "Repeatability: 2 motions, each alone, give 11.9 to 12.1 kg, a range of 1.7 %.",
            {},
            ["12,00", "0,10", "2 Fahrten, jede für sich, ergeben 11,9 bis 12,1 kg", "Blatt mit den Feldern"],
        ),
        ("", {"document": None, "cause": UNEXPLAINED}, ["Kein Ergebnis", "unterscheidet sich kein Drehmoment"]),
    ],
    ids=["friction", "repeated", "failed"],
)
def test_a_result_is_told_in_german(root: Path, sentence: str, more: Json, told: list[str]) -> None:
    given = everything(root)
    given["payloads/3"] |= {"document": payload() | {"sentences": [sentence]}} | more
    with scripted(answers=given) as service, browsing(f"{service.url}/payload#3", locale="de-DE") as page:
        for one in told:
            expect(page.locator("main")).to_contain_text(one)
        assert page.locator("main [lang=en]").count() == 0
        assert english(page.evaluate(SEEN)) == set()


def test_start_while_the_page_reads_the_campaign_again(root: Path) -> None:
    given = everything(root)
    planned = given["campaigns/1"] | {"state": "planned", "data_check": None}
    document = given["plans/1"]["document"]
    document |= {"request": document["request"] | {"trajectories": 1}}
    sweeps = [given["campaigns/1/sweeps"]["items"][0] | {"state": "planned"}] * len(document["sweeps"])
    given |= {"campaigns": {"items": [planned], "next": None}, "campaigns/1": planned, "payloads": EMPTY}
    given |= {
        "plans/1": given["plans/1"] | {"document": document},
        "campaigns/1/sweeps": {"items": sweeps, "next": None},
    }
    with scripted(answers=given) as service, browsing(f"{service.url}/payload#plan-1") as page:
        expect(page.locator("#start")).to_be_enabled()
        asked = service.requests["campaigns/1"]
        service.frozen.add("campaigns/1")
        service.tell("campaign")
        until(lambda: service.requests["campaigns/1"] > asked, "the page reads it again")
        page.locator("#start").click()
        until(lambda: service.requests["campaigns/1/start"] == 1, "the start arrives")
