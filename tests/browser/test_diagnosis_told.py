"""What the page tells of a diagnosis that is written down here, without a machine."""

import pytest
from playwright.sync_api import expect

from tests.browser.browsing import browsing
from tests.browser.scripted import Json, campaign, scripted
from tests.programs import needs
from tests.stored.documents import axis_document, diagnosis_document

pytestmark = needs("chromium")


def answers(axis: Json) -> dict[str, Json]:
    """One finished diagnosis of an axis."""
    entry: Json = {
        "id": 1, "machine": "cell", "here": True, "robot_id": 1, "campaigns": [1], "axes": ["joint_1"], "model": None,
        "estimate": None, "state": "done", "cause": "", "verdicts": {"joint_1": axis["verdict"]}, "parent": None,
        "experiment": None, "weighed": None, "unattended": False, "created_at": "2026-03-02T12:00:00Z",
        "finished_at": "2026-03-02T12:01:00Z",
    }  # fmt: skip
    return {
        "campaigns": {"items": [campaign(1, state="completed")], "next": None},
        "diagnoses": {"items": [entry], "next": None},
        "diagnoses/1": entry | {"document": diagnosis_document(joint_1=axis)},
        "diagnoses/1/figures": {"axes": {"joint_1": {}}},
        "machines": {"items": [], "next": None, "missing": []},
    }


@pytest.mark.parametrize("place", ["effects", "part"])
def test_a_coefficient_of_which_the_sweeps_tell_nothing_is_not_shown(place: str) -> None:
    effect = axis_document(("coulomb_friction",))["effects"][0]
    known = {"value": 40.0, "std": 0.5, "unit": "N m"}
    effect |= {"parameters": {"coulomb": known, "extra": {"value": 880.0, "std": 640_000.0, "unit": "N m"}}}
    axis = axis_document((), verdict="named" if place == "effects" else "unknown") | {place: [effect]}
    with scripted(answers=answers(axis)) as service, browsing(f"{service.url}/diagnosis#1") as page:
        expect(page.locator(f"#{place} table")).to_contain_text("40.00 ± 0.50 N m")
        expect(page.locator(f"#{place} .quiet")).to_have_text("Not significant, so not shown: extra.")
        assert "880" not in page.locator(f"#{place}").inner_text()
