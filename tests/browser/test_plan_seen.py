"""The plan page plans for the robot and the cell of the machine; what starts from the page is what it showed."""

import shutil
from pathlib import Path

import pytest
from playwright.sync_api import expect

from service.web.client import ServiceClient
from tests.browser.browsing import browsing
from tests.browser.conftest import connected
from tests.browser.scripted import scripted
from tests.browser.test_german import everything
from tests.programs import needs
from tests.system.rest_bench import CONFIG, VirtualMachine, serving, until

pytestmark = needs("chromium")


def test_the_machines_cell_is_preselected_and_another_is_typed(tmp_path: Path, machine: VirtualMachine) -> None:
    cells = tmp_path / "cells"
    cells.mkdir()
    shutil.copy(CONFIG / "cells" / "workshop.yaml", cells)
    (cells / "bench.yaml").write_text("name: bench\n", "utf-8")
    with serving(tmp_path, machine.profile, cells_dir=str(cells), cell="workshop") as service:
        with ServiceClient(service.url) as client:
            until(lambda: connected(client), "the machine is connected")
        with browsing(f"{service.url}/plan") as page:
            expect(page.locator("#cell")).to_have_value("workshop")
            expect(page.locator("#robot option:checked")).to_contain_text("max100-class")
            expect(page.locator("#confirm")).to_be_hidden()
            expect(page.get_by_role("group", name="Axes to measure").get_by_role("checkbox").first).to_be_checked()
            page.locator("#cell").select_option("bench")
            expect(page.locator("#confirm-why")).to_contain_text("robot max100-class in cell workshop")
            expect(page.locator("#confirm-robot-choice")).to_be_hidden()
            page.locator("#confirm-cell").fill("bench")
            page.locator("#amount").fill("1")
            page.locator("#make").click()
            expect(page.locator("#motion .subject")).to_contain_text(
                "in cell bench, machine machine. NOT those of the machine, confirmed by typing: bench"
            )
            expect(page.locator("#motion .approach")).to_contain_text("Approach from where the axes stood at")
            page.locator("#take").click()
            page.locator("#taken a").click()
            expect(page.locator("#ordered-title")).to_have_text("What Start will move")
            expect(page.locator("#motion .subject")).to_contain_text("in cell bench, machine machine. NOT those")
            expect(page.locator("#motion .approach")).to_contain_text("joint_2 from 0")
            page.locator("#start").click()
            expect(page.locator("#campaign-state")).to_have_text("running")


ALONE = "joint_3 alone: the sines of joint_3 would move joint_1 by 3.1 times its own, limit 1.4"


@pytest.mark.parametrize(
    ("locale", "groups", "alone", "told", "row"),
    [
        (
            "en-US",
            [["joint_1", "joint_2"], ["joint_3"]],
            ALONE,
            f"In one sweep: joint_1 + joint_2. One axis at a time would take 4 min 43 s. {ALONE}",
            ["joint_1, joint_2", "at once", "1", "0\u00b0, 0\u00b0"],
        ),
        (
            "de-DE",
            [],
            ALONE,
            "Eine Achse nach der anderen. joint_3 allein: die Sinus von joint_3 w\u00fcrden joint_1 um das 3,1-Fache "
            "der eigenen bewegen, Grenze 1,4",
            ["joint_1, joint_2", "gleichzeitig", "1", "0\u00b0, 0\u00b0"],
        ),
    ],
)
def test_which_axes_move_at_once(
    root: Path, locale: str, groups: list[list[str]], alone: str, told: str, row: list[str]
) -> None:
    given = everything(root)
    document = given["plans"]["document"]
    sweep = document["sweeps"][0]
    common = {"pose": [0.0] * 6, "excitation": "trajectory", "block": "trajectory 1 of 2 axes"}
    document |= {
        "request": document["request"] | {"simultaneous": True},
        "sweeps": [sweep | {"spec": sweep["spec"] | common | {"axis": axis}} for axis in ("joint_1", "joint_2")],
        "groups": groups,
        "compared": [{"groups": [], "realisations": 1, "duration": 283.0, "confidence": 1.0, "reason": ""}],
        "alone": alone,
    }
    with scripted(answers=given) as service, browsing(f"{service.url}/plan", locale=locale) as page:
        expect(page.locator("#axes-measured input")).not_to_have_count(0)
        page.locator("#at-once").check()
        with page.expect_request(lambda request: request.method == "POST") as asked:
            page.locator("#make").click()
        assert (asked.value.post_data_json or {})["simultaneous"] is True
        expect(page.locator("#groups")).to_have_text(told)
        assert page.locator(":lang(de) #groups [lang=en]").count() == 0
        expect(page.locator("#motion tbody tr")).to_have_count(1)
        assert page.locator("#motion tbody td").all_inner_texts()[1:5] == row
        page.locator("#budget").select_option("diagnosis")
        expect(page.locator("#at-once")).to_be_hidden()
