"""A number that stands in several places is the same in all of them: plan, page, report, sheet, command and README."""

import json
import re
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from playwright.sync_api import Page, expect

import sweepid
from service.cli.commands.campaigns import tell_plan
from service.cli.demo import ERRORS, SCENARIO, compare
from service.cli.report_pages import bundle_page
from service.cli.virtual_cell import CELL, ROBOT
from service.formats.export.sheets.making import sheet
from service.formats.export.sheets.text import as_markdown
from service.identification.design.diagnosis_sweeps import paper_design
from service.model.configuration import read_cell, read_robot
from service.model.results.estimate import CONFIDENCE, Estimate
from service.model.results.part import two_digits, with_std
from service.planning.documents import PlanRequest
from service.planning.poses import workspace_grid
from service.report.content import axes_of, content_of
from service.store.files.bundle import Bundle, write_bundle
from service.web.hmi.pages import texts
from simulator import load_scenario
from tests.browser.browsing import browsing
from tests.browser.scripted import Json, campaign, scripted
from tests.browser.test_diagnosis_page import measured
from tests.browser.test_german import everything, plan as make_plan
from tests.programs import needs

pytestmark = needs("chromium")
AXES = ("joint_1", "joint_2", "joint_3")
CAD = "CAD model, whole workspace"
Told = Iterator[tuple[str, str]]  # what, and its number as it is written


@pytest.fixture(scope="module")
def bundle(root: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Bundle, Path]:
    """A finished campaign of the virtual robot: three axes in 25 poses."""
    robot = read_robot(root / ROBOT)
    poses = np.array([[0, a, b, 0, 0, 0] for a in np.linspace(-0.9, 1.2, 5) for b in np.linspace(-2.2, 1.0, 5)])
    designed = [one for axis in AXES for one in paper_design(robot, axis, poses, sample_rate=250.0)]
    sweeps = measured(load_scenario(root / "config/scenarios/max100-full.yaml"), designed)
    for number, one in enumerate(sweeps, start=1):
        object.__setattr__(one, "spec", one.spec.model_copy(update={"id": f"{number:04d}"}))
    made, folder = Bundle(robot, tuple(sweeps)), tmp_path_factory.mktemp("finished") / "bundle"
    write_bundle(folder, robot, sweeps)
    return made, folder


def of_report(made: Bundle, found: Estimate, folder: Path) -> Told:
    page = bundle_page(made, found, str(folder))
    tables = json.loads(page.written("json"))["tables"]
    first = re.search(rf"known to (\S+) % or better \(confidence: {CONFIDENCE}; (\w+) is the least", page.html())
    assert first is not None
    yield from _axis(first[2], confidence=first[1])
    for told, value in tables[0]["rows"]:
        joint, low, high, cad, percent, confidence = re.fullmatch(
            r"J of (\w+), (\S+) to (\S+); CAD (\S+), (\S+) %; confidence (\S+) %", told
        ).groups()  # type: ignore[union-attr]
        j, std = re.fullmatch(r"(\S+) ± (\S+) kg m²", value).groups()  # type: ignore[union-attr]
        yield from _axis(joint, J=j, std=std, low=low, high=high, CAD=cad, percent=percent, confidence=confidence)
    for table in tables:
        if table["section"] == "Base parameters":
            for name, cad, value, std, *_ in table["rows"]:
                yield from _axis(name, CAD=cad, value=value, std=std)
        if table["head"][0] == "RMSE in %":
            for k, joint in enumerate(table["head"][1:], start=1):
                yield from _rmse(joint, [row[k] for row in table["rows"]])


def of_sheet(made: Bundle, found: Estimate, folder: Path) -> Told:
    text = as_markdown(sheet(made.robot, found, str(folder)))
    for row in re.findall(r"^\| (joint_\d) \| (.*kg m².*) \|$", text.partition("## Sinumerik")[0], re.MULTILINE):
        cad, j, std, span, differs = row[1].split(" | ")
        low, high = span.split(" ... ")
        cad, j, std = (one.removesuffix(" kg m²") for one in (cad, j, std))
        yield from _axis(row[0], J=j, std=std, low=low, high=high, CAD=cad, percent=differs.split(" %")[0])


def of_command(found: Estimate) -> Told:
    text = str(found)
    stated = re.search(rf"Confidence of J \({re.escape(CONFIDENCE)}\): (.*)", text)
    assert stated is not None
    for joint, percent in re.findall(r"(joint_\d) (\S+) %", stated[1]):
        yield from _axis(joint, confidence=percent)
    for row in text.partition("Base parameters")[2].splitlines():
        if cells := re.fullmatch(r"(\S.*\S)  +(\S+)  +(\S+)  +(\S+)", row):
            yield from _axis(cells[1].strip(), CAD=cells[2], value=cells[3], std=cells[4])
    rows = re.findall(r"^(?:reference|identified) - .*?  +(\S+)  +(\S+)  +(\S+)$", text, re.MULTILINE)
    for k, joint in enumerate(AXES):
        yield from _rmse(joint, [row[k] for row in rows])


def of_results(page: Page) -> Told:
    expect(page.locator("#table tbody tr")).to_have_count(3)
    for row in page.locator("#table tbody tr").all():
        joint, _, *rmse, confidence = (one.removesuffix(" %") for one in row.locator("td").all_inner_texts())
        yield from _rmse(joint, rmse)
        yield from _axis(joint, confidence=confidence)
    expect(page.locator("#earlier tbody tr")).to_have_count(3)
    for row in page.locator("#earlier tbody tr").all():
        _, joint, _, percent, confidence = (one.removesuffix(" %") for one in row.locator("td").all_inner_texts())
        yield from _axis(joint, rmse3=percent, confidence=confidence)


def of_operator_page(page: Page) -> Told:
    expect(page.locator("#parameters tr").first).to_be_visible()
    for row in page.locator("#parameters tr").all():
        name, cad, value, std = row.locator("td").all_inner_texts()
        yield from _axis(name, CAD=cad.replace("−", "-"), value=value.replace("−", "-"), std=std)


def of_plan(page: Page) -> Told:
    expect(page.locator("#axes-measured input").first).to_be_visible()
    make_plan(page)
    told = re.fullmatch(rf"Expected confidence of J: (\S+) %, {CONFIDENCE}\.", page.locator("#promise").inner_text())
    assert told is not None
    yield from _axis("plan", confidence=told[1])


def of_plan_command(plan: Json, capsys: pytest.CaptureFixture[str]) -> Told:
    tell_plan(plan["document"], plan["expected_time"])
    told = re.search(r"confidence of J: expected (\S+) % in the workspace", capsys.readouterr().err)
    assert told is not None
    yield from _axis("plan", confidence=told[1])


def of_readme(root: Path) -> Told:
    lines = (root / "README.md").read_text("utf-8").splitlines()
    rows = [[cell.strip() for cell in line.strip("|").split("|")] for line in lines if line.startswith("| ")]
    errors = {row[0]: row[1:] for row in rows if len(row) == 1 + len(AXES)}
    assert tuple(errors)[1:] == ERRORS  # in the demo's words
    for joint, cell in zip(AXES, errors[CAD], strict=True):  # the row that no noise touches
        yield from _axis(joint, error_of_cad=cell)


def of_demo(made: Bundle, found: Estimate, scratch: Path) -> Told:
    request = PlanRequest(robot_id=1, cell=CELL.stem, axes=AXES, varied=AXES[1:], poses=24)
    workspace = workspace_grid(made.robot, request, read_cell(CELL))
    content = content_of(made.robot, found, [one.spec for one in made.sweeps], lambda _: made.sweeps[0], "")
    in_cell = replace(content, workspace=workspace)
    rows = {row.label: row.figures for row in compare(in_cell, axes_of(in_cell), SCENARIO, scratch)}
    for joint, cell in zip(AXES, rows[CAD], strict=True):
        yield from _axis(joint, error_of_cad=cell)


def _axis(name: str, **values: str) -> Told:
    yield from ((f"{name}: {what}", value) for what, value in values.items())


def _rmse(joint: str, values: list[str]) -> Told:
    yield from ((f"{joint}: rmse{k}", value) for k, value in enumerate(values, start=1))


def test_a_number_in_two_places_is_one_number(
    bundle: tuple[Bundle, Path],
    root: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(root)
    made, folder = bundle
    found = sweepid.identify(made)
    places: dict[str, dict[str, set[str]]] = defaultdict(lambda: defaultdict(set))
    told: dict[str, Told] = {
        "report": of_report(made, found, folder),
        "sheet": of_sheet(made, found, folder),
        "command": of_command(found),
        "README": of_readme(root),
        "demo": of_demo(made, found, tmp_path / "poses.json"),
    }
    planned = everything(root)
    planned["plans"]["document"] |= {"confidence": [None, 0.51487], "alone": ""}
    told["command of the plan"] = of_plan_command(planned["plans"], capsys)
    with scripted(answers=planned) as service, browsing(f"{service.url}/plan") as page:
        told["plan"] = iter(list(of_plan(page)))
    with scripted(answers=answers(found)) as service:
        with browsing(f"{service.url}/results#campaign-1") as page:
            told["results"] = iter(list(of_results(page)))
        with browsing(f"{service.url}/#campaign-1") as page:
            told["page"] = iter(list(of_operator_page(page)))
    for place, numbers in told.items():
        for what, number in numbers:
            places[what][place].add(number)
    assert {what: dict(of) for what, of in places.items() if len(set[str]().union(*of.values())) > 1} == {}
    # no place is silent. Each axis: J, std, low, high, CAD, difference and, of CAD, the error against the truth in two;
    # confidence and three deviations in three; each base parameter: CAD, value, std in three; the plan's promise in two
    told_in = sum(len(of) for of in places.values() if len(of) > 1)
    assert told_in == len(AXES) * (7 * 2 + 4 * 3) + 3 * 3 * len(found.base_parameters) + 2
    assert all(CONFIDENCE in texts()["en"][name] for name in ("plan.promise", "results.confidence-is"))


def answers(found: Estimate) -> dict[str, Json]:
    document: Any = json.loads(found.to_json())
    estimate = {"revision": 1, "number": 75, "document": document}
    one = campaign(1, state="completed")
    percent = {joint: axis["confidence_percent"] for joint, axis in document["axes"].items()}
    return {
        "campaigns": {"items": [one], "next": None},
        "campaigns/1": one,
        "campaigns/1/estimates/latest": estimate,
        "campaigns/1/estimates/convergence": {"wanted": None, "revisions": [{"sweep": 75, "percent": percent}]},
    }


@pytest.mark.parametrize("percent", [0.0467, 0.4, 0.415, 1.26, 12.34, 130.4])
def test_a_confidence_has_two_figures_on_the_page_as_everywhere(percent: float) -> None:
    with scripted() as service, browsing(service.url) as page:
        told = page.evaluate("async (percent) => (await import('./elements.js')).confidence(percent)", percent)
        assert told == f"{two_digits(percent)} %"


VALUES = (
    0.0,
    5.9234e-7,
    -2.5e-5,
    9.996,
    -9.994,
    0.0996,
    268.5314,
    -12347.8,
    99999.4,
    0.00012345,
    61.27,
    -1.5411,
    1000.0,
    12.0,
)
STDS = (None, 0.0, 9.5, 0.5, 0.0996, 123.0, 99.6, 1.0, 1e-3, 1000.0, 2.3e-5, 13.0, 1.4e-8, 9.96e-10)


def test_values_end_where_their_std_ends_on_the_page_as_everywhere() -> None:
    pairs = [(value, std) for value in VALUES for std in STDS if std or not 0 < abs(value) < 1e-4]
    with scripted() as service, browsing(service.url) as page:
        told: list[list[str]] = page.evaluate(
            "async (pairs) => { const { measured } = await import('./elements.js');"
            " return pairs.map(([value, std]) => measured(std, value, std || null)); }",
            pairs,
        )
    assert [[one.replace("−", "-") for one in pair] for pair in told] == [[*with_std(*pair)] for pair in pairs]


DURATION = re.compile(r"\b(?:\d+ min )?\d+ s\b")


def test_every_duration_of_a_view_is_of_one_clock(root: Path) -> None:
    """A virtual machine at 8 times its speed: nothing that is left is told in the seconds of the plan."""
    answers: dict[str, Any] = {**everything(root)}
    answers["plans/1"]["document"]["sweeps"][0]["duration"] = 160.0
    answers["campaigns/1/sweeps"] = [answers["campaigns/1/sweeps"]["items"][0] | {"state": "planned"}]
    left = {"done": 0, "total": 1, "remaining": 20.0, "repeat": 0.0, "pace": 0.125, "current": None}
    one = campaign(1, plan_id=1, progress=left)
    answers |= {"campaigns": {"items": [one], "next": None}, "campaigns/1": one}
    with scripted(answers=answers) as service, browsing(service.url) as page:
        expect(page.locator("#motion tbody tr")).to_have_count(1)
        told = page.locator("#takes, #motion > p, #motion td:last-child").all_inner_texts()
        assert DURATION.findall(" ".join(told)) == ["20 s"] * 3
