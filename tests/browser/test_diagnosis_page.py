"""The diagnosis page in a real browser: what it finds, and that nothing moves before it is approved there."""

import shutil
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
import pytest
from playwright.sync_api import Page, expect

from service.identification.design.diagnosis_sweeps import DesignedSweep, full_design, paper_design
from service.model import Recording, Sweep
from service.model.configuration import read_robot
from service.store.files.bundle import write_bundle
from service.web.client import ServiceClient
from simulator import Scenario, SweepRun, load_scenario, run_sweeps
from tests.browser.browsing import browsing
from tests.browser.looking import overlaps
from tests.programs import needs
from tests.system.rest_bench import ROBOT, Service, VirtualMachine, serving, until, virtual_machine
from tests.system.test_diagnosis_campaign import AXIS, hiding

POSES = np.array([[0.0, 0.3, -1.2, 0.0, 0.0, 0.0], [0.6, -0.2, -0.6, 0.0, 0.0, 0.0]])
RATE = 250.0  # Hz
BLOCKS = ("forward_slow", "backward_slow", "reversal")
ONE_WAY, BOTH_WAYS = 1, 2  # campaigns, in the order of their import

pytestmark = needs("chromium")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("diagnosis-page")


@pytest.fixture(scope="module")
def machine(folder: Path) -> Iterator[VirtualMachine]:
    with virtual_machine(folder, speed_factor=1.0, scenario=hiding(folder)) as machine:
        yield machine


@pytest.fixture(scope="module")
def service(folder: Path, machine: VirtualMachine) -> Iterator[Service]:
    """With two measured campaigns of the machine: one direction only, and one that shows everything about friction."""
    robot, scenario = read_robot(ROBOT), load_scenario(folder / "hiding.yaml")
    designs = (
        paper_design(robot, AXIS, POSES, sample_rate=RATE),
        full_design(robot, AXIS, POSES, sample_rate=RATE, blocks=BLOCKS),
    )
    with serving(folder, machine.profile) as service, ServiceClient(service.url) as client:
        for number, designed in enumerate(designs, start=1):
            bundle = folder / f"bundle-{number}"
            write_bundle(bundle, robot, measured(scenario, designed))
            client.import_bundle(Path(shutil.make_archive(str(bundle), "zip", bundle)))
        yield service


@pytest.fixture
def page(service: Service) -> Iterator[Page]:
    with browsing(f"{service.url}/diagnosis") as page:
        yield page


def measured(scenario: Scenario, designed: Sequence[DesignedSweep]) -> list[Sweep]:
    runs = [
        SweepRun(
            axis=one.spec.axis,
            pose=one.spec.pose,
            offset_velocity=one.spec.offset_velocity,
            sines=tuple((sine.frequency, sine.amplitude, sine.phase) for sine in one.spec.sines),
            period=one.spec.period or 1.0,
            periods=one.spec.periods or 1,
            ramp=one.ramp,
            settle=one.settle,
            sample_rate=one.spec.sample_rate,
            started_at=one.spec.started_at,
        )
        for one in designed
    ]
    columns = run_sweeps(scenario, runs, 1)
    return [Sweep(one.spec, Recording(**samples)) for one, samples in zip(designed, columns, strict=True)]


def diagnose(page: Page, campaign: int) -> None:
    page.get_by_label(f"{campaign} (robot", exact=False).check()
    page.locator("#start").select_option("cad")  # whether the other campaign is identified by now is chance
    page.get_by_role("button", name="Diagnose").click()
    expect(page.locator("#shown-about")).to_contain_text(f"from campaign {campaign}")
    expect(page.locator("#shown-state")).to_have_text("done")


def test_a_named_effect_is_shown_and_accepted(service: Service, page: Page) -> None:
    page.set_viewport_size({"width": 800, "height": 1000})
    diagnose(page, BOTH_WAYS)
    expect(page.locator("#verdict")).to_contain_text(f"{AXIS}: the model lacks")
    expect(page.locator("#effects")).to_contain_text("Coulomb")
    for figure in ("map", "gap_by_pose", "example", "evidence", "parameters"):
        expect(page.locator(f"#figure-{figure} svg.main-svg").first).to_be_visible()
    expect(page.locator("#experiment")).to_be_hidden()
    page.locator("#rigid-model summary").click()
    expect(page.locator("#rigid-before")).to_have_text("CAD")
    rows = page.locator("#rigid-parameters tr")
    expect(rows.last).to_contain_text("viscous friction")
    assert rows.count() > 1
    assert overlaps(page, "#figure-map [class^='yaxislayer'] text", "#figure-map .bars .point path") == 0
    caption = page.locator("#pictures p", has_text="Every other candidate").inner_text()
    with page.expect_popup() as report:
        page.get_by_role("link", name="Report").click()
    expect(report.value.locator("p.verdict")).to_contain_text("the model lacks")
    expect(report.value.locator("p", has_text="Every other candidate")).to_have_text(caption)
    page.locator("#accepted-by").fill("Ada")
    page.get_by_role("button", name="Accept").click()
    expect(page.locator("#accepted")).to_contain_text("Revision 1 of the robot's model, accepted by Ada")
    with ServiceClient(service.url) as client:
        (model,) = client.models()
    assert model["accepted_by"] == "Ada"
    page.locator("#language").select_option("de")
    expect(page.locator("#verdict")).to_contain_text(f"{AXIS}: Dem Modell fehlt: ")
    expect(page.locator("#verdict [lang=en]")).to_have_count(0)


def test_nothing_moves_before_the_experiment_is_approved_and_the_stop_is_at_hand(
    machine: VirtualMachine, service: Service, page: Page
) -> None:
    diagnose(page, ONE_WAY)
    expect(page.locator("#verdict")).to_contain_text("these sweeps do not tell whether")
    page.get_by_role("textbox", name="Cell", exact=True).fill("workshop")
    page.get_by_role("button", name="Prepare").click()
    expect(page.locator("#motion")).to_contain_text("joint_2 is moved between")
    expect(page.locator("#intent")).to_contain_text("No motion is commanded")
    page.get_by_role("button", name="Approve").click()  # without a name: the browser asks for it
    with ServiceClient(service.url) as client:
        assert len(client.campaigns()) == BOTH_WAYS
        diagnoses = len(client.diagnoses())
        assert machine.stands()
        page.locator("#approved-by").fill("Ada")
        page.get_by_role("button", name="Approve").click()
        expect(page.locator("#intent")).to_contain_text("The machine moves: Campaign 3 runs")
        expect(page.locator("#experiment-done")).to_contain_text(f"Approved by Ada for {AXIS}: campaign 3")
        until(lambda: not machine.stands(), "an axis with energy")
        page.get_by_role("button", name="STOP").click()
        until(machine.stands, "standing axes")
        expect(page.locator("#intent")).to_contain_text("Campaign 3 is paused")
        page.get_by_role("link", name="Campaign 3", exact=True).click()
        expect(page.locator("#campaign-state")).to_have_text("paused")
        page.get_by_label("Your name").fill("Ada")
        page.get_by_role("button", name="Machine checked: release", exact=True).click()
        expect(page.locator("#held")).to_be_hidden()
        page.get_by_role("button", name="Abort").click()
        page.get_by_role("button", name="End campaign").click()
        expect(page.locator("#campaign-state")).to_have_text("aborted")
        assert len(client.diagnoses()) == diagnoses  # nothing went on
