"""``python -m tests.browser.screenshots FOLDER``: pictures of the pages and of a report, to look at.

``python -m tests.browser.screenshots docs/images --for-docs --speed-factor 3`` makes those of the docs anew.

A real service and a virtual machine that runs faster than the clock: a campaign is planned, measured and diagnosed, and
each page is photographed at widths of 1280 and 768 px, light and dark, as a palette of 64 colours so that the files are
small. The report is saved as PDF as well.
"""

import argparse
import io
import re
import shutil
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory

from PIL import Image
from playwright.sync_api import Page, expect

from service.web.client import Json, ServiceClient
from tests.browser.browsing import browsing
from tests.browser.conftest import connected
from tests.browser.looking import settled
from tests.system.rest_bench import CONFIG, PATIENT_LEASE, Service, VirtualMachine, serving, until, virtual_machine

SIZES = (1280, 768, 1920)  # px wide
HEIGHT, TALLEST = 800, 2200  # px; of the window, and of a picture of the docs
SCHEMES = ("light", "dark")
COLOURS = 64
AXES = ["joint_2", "joint_3"]

Take = Callable[[str], None]


def main() -> int:
    wanted = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    wanted.add_argument("folder", type=Path, help="where the PNG files go")
    wanted.add_argument("--locale", default="en-GB", help="language and country of the browser")
    wanted.add_argument("--poses", type=int, default=6, help="poses of the campaign")
    wanted.add_argument("--speed-factor", type=float, default=8.0, help="of the virtual machine against the clock")
    wanted.add_argument("--for-docs", action="store_true", help="those of the docs alone, light and 1280 px wide")
    given = wanted.parse_args()
    given.folder.mkdir(parents=True, exist_ok=True)
    with TemporaryDirectory() as work, virtual_machine(Path(work), given.speed_factor) as machine:
        cells = Path(work) / "cells"
        cells.mkdir()
        shutil.copy(CONFIG / "cells" / "workshop.yaml", cells)
        (cells / "bench.yaml").write_text("name: bench\n", "utf-8")
        with (
            serving(Path(work), machine.profile, PATIENT_LEASE, cells_dir=str(cells), cell="workshop") as service,
            browsing(f"{service.url}/plan", locale=given.locale) as page,
        ):
            take = camera(page, given.folder, given.for_docs)
            _pages(page, service, machine, given.poses, take, given.folder, given.for_docs)
        with (
            serving(Path(work), machine.profile, PATIENT_LEASE, login=True) as service,
            browsing(service.url, locale=given.locale) as page,
        ):
            expect(page.locator("#login")).to_be_visible()
            camera(page, given.folder, given.for_docs)("login-page")
    return 0


def _pages(
    page: Page, service: Service, machine: VirtualMachine, poses: int, take: Take, folder: Path, for_docs: bool
) -> None:
    with ServiceClient(service.url) as client:
        until(lambda: connected(client), "the machine is connected", 300.0)
        page.goto(service.url, wait_until="commit")
        expect(page.locator("#axes tr")).to_have_count(6)
        take("page-first")
        page.goto(f"{service.url}/plan", wait_until="commit")
        expect(page.locator("#cell")).to_have_value("workshop")
        page.locator("#cell").select_option("bench")
        expect(page.locator("#confirm")).to_be_visible()
        take("page-plan-other-cell")
        page.locator("#cell").select_option("workshop")
        _planned(page, poses)
        expect(page.locator("#views svg")).to_have_count(2)
        take("plan-page")
        page.locator("#take").click()
        page.locator("#taken a").click()
        expect(page.locator("#start")).to_be_enabled()
        expect(page.locator("#motion li").first).to_be_visible()
        take("page-before-start")
        page.locator("#start").click()
        campaign = int(client.campaigns()[-1]["id"])
        until(lambda: int(client.campaign(campaign)["progress"]["done"]) >= 3, "three sweeps", 600.0)
        expect(page.locator("#parameters tr").first).to_be_visible()
        expect(page.locator("#live-title")).to_contain_text(re.compile("^Live.*joint"))
        expect(page.locator("#intent")).to_contain_text("joint")
        expect(page.locator("#live-chart .scatterlayer .trace")).to_have_count(2)
        expect(page.locator("#campaign-state")).to_have_class("badge running")
        take("operator-page")
        page.evaluate("localStorage.setItem('sweepid-names', 'Ada\\nGrace')")
        page.locator("#stop").click()
        expect(page.locator("#held")).to_be_visible()
        expect(page.locator("#way-out li")).to_have_count(3)
        expect(page.locator("#live")).to_be_hidden()
        take("stopped-page")
        page.locator("#release-as button").first.click()
        expect(page.locator("#held")).to_be_hidden()
        page.locator("#resume").click()
        expect(page.locator("#campaign-state")).to_have_class("badge running")
        machine.order("fault", joint=AXES[0], code=0x2310)
        expect(page.locator("#campaign-state")).to_have_class("badge paused broken")
        take("page-fault")
        page.get_by_role("button", name=re.compile("acknowledge|quittieren")).first.click()
        expect(page.locator("td.fault:not(:empty)")).to_have_count(0)
        take("page-after-fault")
        expect(page.locator("#resume")).to_be_enabled()
        page.locator("#resume").click()
        until(lambda: _is(client.campaign(campaign), "completed"), "the campaign", 900.0)
        page.goto(f"{service.url}/#campaign-{campaign}", wait_until="commit")
        expect(page.locator("#parameters tr").first).to_be_visible()
        take("page-completed")
        page.goto(f"{service.url}/results#campaign-{campaign}", wait_until="commit")
        expect(page.locator("#response .scatterlayer .trace")).to_have_count(2)
        take("results-page")
        client.diagnosed(int(client.add_diagnosis([campaign], AXES[:1])["id"]))
        page.goto(f"{service.url}/diagnosis", wait_until="commit")
        expect(page.locator("#diagnoses tr, table tbody tr").first).to_be_visible()
        expect(page.locator("#pictures .main-svg").last).to_be_visible()
        take("diagnosis-page")
        page.goto(f"{service.url}/fleet", wait_until="commit")
        expect(page.locator("#robots tbody tr").first).to_be_visible()
        take("page-fleet")
        if not for_docs:
            (folder / "report.html").write_bytes(client.campaign_report(campaign))
            (folder / "report.pdf").write_bytes(client.campaign_report(campaign, "pdf"))
            page.goto((folder / "report.html").absolute().as_uri())
            take("report-campaign")
        until(machine.stands, "standing axes")


def _is(campaign: Json, state: str) -> bool:
    return bool(campaign["state"] == state)


def _planned(page: Page, poses: int) -> None:
    """Poses of two axes."""
    expect(page.locator("#axes-measured input")).to_have_count(6)
    page.locator("#axes-measured [value=joint_1]").uncheck()
    page.locator("#amount").fill(str(poses))
    page.locator("#make").click()
    expect(page.locator("#planned")).to_be_visible()


def camera(page: Page, folder: Path, for_docs: bool) -> Take:
    """What photographs the whole page as it is now, in each width and scheme, into `folder`."""

    def take(name: str) -> None:
        if for_docs and not name.endswith("-page"):
            return
        for width in SIZES[:1] if for_docs else SIZES:
            page.set_viewport_size({"width": width, "height": HEIGHT})
            for scheme in SCHEMES[:1] if for_docs else SCHEMES:
                page.emulate_media(color_scheme=scheme)
                settled(page)
                page.wait_for_timeout(600)  # plots follow the size of their panel after a pause of their own
                picture = Image.open(io.BytesIO(page.screenshot(full_page=True)))
                if for_docs:
                    picture = picture.crop((0, 0, picture.width, min(picture.height, TALLEST)))
                path = folder / (f"{name}.png" if for_docs else f"{name}-{scheme}-{width}.png")
                picture.convert("RGB").quantize(COLOURS).save(path, optimize=True)
                print(f"{path}: {picture.width} x {picture.height}, {path.stat().st_size / 1e3:.0f} kB", flush=True)
        page.set_viewport_size({"width": SIZES[0], "height": HEIGHT})
        page.emulate_media(color_scheme=SCHEMES[0])

    return take


if __name__ == "__main__":
    raise SystemExit(main())
