"""What the page tells of a diagnosis that is written down here, without a machine."""

from pathlib import Path

import pytest
from playwright.sync_api import expect

from tests.browser.browsing import browsing
from tests.browser.looking import overlaps
from tests.browser.scripted import scripted
from tests.browser.test_german import everything, of_diagnosis
from tests.programs import needs
from tests.stored.documents import axis_document, stored
from tests.system.rest_bench import until

pytestmark = needs("chromium")


@pytest.mark.parametrize("place", ["effects", "part"])
def test_a_coefficient_of_which_the_sweeps_tell_nothing_is_not_shown(place: str) -> None:
    effect = axis_document(("coulomb_friction",))["effects"][0]
    known = {"value": 40.0, "std": 0.5, "unit": "N m"}
    effect |= {"parameters": {"coulomb": known, "extra": {"value": 880.0, "std": 640_000.0, "unit": "N m"}}}
    axis = axis_document((), verdict="named" if place == "effects" else "unknown") | {place: [effect]}
    with scripted(answers=of_diagnosis(axis)) as service, browsing(f"{service.url}/diagnosis#1") as page:
        expect(page.locator(f"#{place} table")).to_contain_text("40.00 ± 0.50 N m")
        expect(page.locator(f"#{place} .quiet")).to_have_text("Not significant, so not shown: extra.")
        assert "880" not in page.locator(f"#{place}").inner_text()


def test_what_is_known_in_part_the_check_of_the_data_and_where_it_started_are_shown() -> None:
    finding = {"severity": "warning", "code": "coarse_steps", "sentence": "Steps of 4 N m.", "action": "Record finer."}
    effects = axis_document(("coulomb_friction",))["effects"]
    given = of_diagnosis(axis_document((), verdict="unknown", part=effects, data=[finding]))
    given["diagnoses/1"]["estimate"] = {"campaign_id": 7, "revision": 3}
    given["diagnoses/1"]["document"]["axes"]["joint_1"]["started_from"] = "campaign 7, revision 3"
    with scripted(answers=given) as service, browsing(f"{service.url}/diagnosis#1") as page:
        expect(page.locator("#part")).to_contain_text("Known in part; a part of the gap")
        expect(page.locator("#effects")).to_be_empty()
        expect(page.locator("#data")).to_contain_text("warning, resolution too coarse: Steps of 4 N m. Record finer.")
        expect(page.locator("#rigid-before")).to_have_text("Estimate")
        expect(page.locator("#shown-about")).to_contain_text("rigid model from the estimate of campaign 7, revision 3")


def test_a_test_mass_is_told_with_its_place_in_units_of_the_shop(root: Path) -> None:
    experiment = stored("diagnosis-open")["axes"]["joint_1"]["next_experiment"] | {"kind": "test_mass"}
    given = everything(root)
    given["diagnoses/1"]["document"]["axes"]["joint_1"] |= {"verdict": "ambiguous", "next_experiment": experiment}
    given["diagnoses/1/plan"] = given["plans/1"]
    with scripted(answers=given) as service, browsing(f"{service.url}/diagnosis#1") as page:
        page.locator("#prepare button").click()
        told = {"#mass-kg": "40", "#mass-x": "100", "#mass-y": "0", "#mass-z": "-12,5", "#approved-by": "Ada"}
        for field, text in told.items():
            page.locator(field).fill(text)
        with page.expect_request("**/experiment") as request:
            page.get_by_role("button", name="Approve").click()
    sent = request.value.post_data_json
    assert sent is not None
    assert sent["test_mass"] == {"mass": 40, "center": [0.1, 0, -0.0125], "inertia": [0, 0, 0, 0, 0, 0]}
    assert sent["approved_by"] == "Ada"


def test_no_name_of_the_chart_lies_over_another(root: Path) -> None:
    with scripted(answers=everything(root)) as service, browsing(f"{service.url}/#campaign-1") as page:
        page.set_viewport_size({"width": 320, "height": 900})
        expect(page.locator("#chart .xtick text").first).to_be_visible()
        until(lambda: overlaps(page, "#chart .xtick text", "#chart .xtitle") == 0, "names beside each other", 10.0)
