"""The plan page plans for the robot and the cell of the machine; what starts from the page is what it showed."""

import shutil
from pathlib import Path

from playwright.sync_api import expect

from service.web.client import ServiceClient
from tests.browser.browsing import browsing
from tests.browser.conftest import connected
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
