"""The report: figures from documents worked out by hand, one file that needs nothing else."""

import json
import re
from typing import Any

import numpy as np
import pytest

from service.identification.axis.ideal_frequency import InitialAnalysis
from service.identification.estimates.initial_analysis import analyses_document
from service.identification.model import axis_rows, lock
from service.model import INERTIAL_NAMES, Recording, Robot, Sine, Sweep, SweepSpec, build_robot
from service.model.results.estimate import BaseParameter, Estimate
from service.report.campaign import campaign_page
from service.report.content import CampaignReport, Content, TruthRow, axes_of, revision
from service.report.figures import parameter_unit
from service.report.html import ReportPage
from service.report.initial_analysis import amplitude_responses, ideal_frequencies, table
from service.report.page import analysis_page
from tests.unit.service.campaigns.small_arm import small_arm
from tests.unit.service.identification.test_ideal_frequency import FREQUENCY, LOADS, STIFF, analysis

AXES = ("joint_1", "joint_2", "joint_3")
HEAVIER = 1.1  # the "identified" robot: every link and motor by this factor


def content(robot: Robot, **changes: Any) -> Content:
    """Four poses, three axes; measured is 1 % above the identified model."""
    chain = lock(robot.chain, {3: 0.0, 4: 0.0, 5: 0.0})
    motors = [axis.reflected_motor_inertia or 0.0 for axis in robot.axes[:3]]
    nominal = np.concatenate([chain.inertial.ravel(), motors])
    poses = [(0.0, a, b, 0.0, 0.0, 0.0) for a in (-0.5, 0.5) for b in (-1.0, 0.0)]
    specs: list[SweepSpec] = []
    rmse = {"reference_measured": 9.0, "identified_measured": 0.5, "reference_identified": 8.0}
    axes: dict[str, Any] = {joint: {"inertia": [], "rmse_percent": rmse} for joint in AXES}
    for pose in poses:
        for k, joint in enumerate(AXES):
            name = f"{len(specs) + 1:04d}"
            specs.append(spec(name, joint, pose))
            value = 1.01 * HEAVIER * float(axis_rows(chain, k, np.array(pose[:3]))[0] @ nominal)
            sizes = {"value": value, "std": 0.01 * value, "paper_value": 1.1 * value}
            axes[joint]["inertia"].append({"sweep": name, "reference": value, "identified": value, **sizes})
    estimate = {
        "axes": axes,
        "base_parameters": [{"name": "Izz(link_1) + m(link_2)", "value": 3.0, "std": 0.1}],
        "condition_number": 12.5,
        "standard_parameters": {
            "links": {
                joint.link: dict(zip(INERTIAL_NAMES, (HEAVIER * chain.inertial[k]).tolist(), strict=True))
                for k, joint in enumerate(chain.joints)
            },
            "motor_inertias": {f"Jm({joint})": HEAVIER * motor for joint, motor in zip(AXES, motors, strict=True)},
        },
    }
    grid = np.array([(0.0, a, b, 0.0, 0.0, 0.0) for a in (-0.5, 0.0, 0.5) for b in (-1.0, 0.0)])
    return Content(
        **{
            "title": "Robot <1>",
            "subtitle": "a test",
            "robot": robot,
            "estimate": Estimate.read(estimate, "estimate"),
            "specs": tuple(specs),
            "workspace": grid,
            **changes,
        }
    )


def estimate_page(content: Content) -> ReportPage:
    """The report of an estimate alone."""
    report = CampaignReport(title=content.title, subtitle="", origin=(), drives=(), check=None, diagnosis=None)
    return campaign_page(report, content.robot.joints, content.estimate, content)


def spec(name: str, joint: str, pose: tuple[float, ...]) -> SweepSpec:
    sines = (Sine(frequency=2.0, amplitude=0.004, phase=0.0),)
    times: dict[str, Any] = {"period": 1.0, "periods": 3, "measure_from": 1.0, "sample_rate": 250.0}
    return SweepSpec(id=name, axis=joint, pose=pose, offset_velocity=0.01, sines=sines, **times)


def sweep() -> Sweep:
    time = np.arange(1125) / 250.0
    velocity = 0.01 + 0.004 * np.sin(2 * np.pi * 2.0 * time)
    recording = Recording(time, effort=100 * velocity, velocity=velocity, position=0.01 * time)
    return Sweep(spec("0001", "joint_1", (0.0,) * 6), recording)


def figures(page: ReportPage) -> list[Any]:
    return [part for part in page._parts if not isinstance(part, str)]  # pyright: ignore[reportPrivateUsage]


def test_models_of_the_estimate(max100: Robot) -> None:
    axes = axes_of(content(max100))
    for axis in axes:
        assert axis.measured == pytest.approx(1.01 * axis.identified)
        assert axis.identified == pytest.approx(HEAVIER * axis.reference)
        assert axis.identified_workspace == pytest.approx(HEAVIER * axis.reference_workspace)
    assert [axis.varied for axis in axes] == [(1, 2), (2,), ()]


@pytest.mark.slow
def test_one_light_file_that_loads_nothing_with_the_tables_of_the_estimate(max100: Robot) -> None:
    page = estimate_page(content(max100, example=sweep())).html()
    assert len(page) < 800_000
    for label, figure in (("reference model − measurement", 9), ("identified model − measurement", 0.5)):
        assert f"{label}</td>" + 3 * f"<td>{figure:.2f}</td>" in page
    assert "<td>3.00</td><td>0.10</td><td>kg m²</td>" in page
    assert not re.search(r"<script|\b(src|href)\s*=\s*\"(?!#)(?!data:)", page)
    assert "Robot &lt;1&gt;" in page
    assert estimate_page(content(max100, example=sweep())).html() == page


def test_maps_of_difference_and_inertia_with_the_measured_poses(max100: Robot) -> None:
    report = content(max100)
    differs, inertias = figures(estimate_page(report))[:2]
    percent = 100 * (1 - 1 / HEAVIER)  # of one sign: the colours lie where it does
    assert [differs["data"][0][end] for end in ("zmin", "zmax")] == pytest.approx(
        [percent - 0.25, percent + 0.25], 1e-4
    )
    field, _, measured = inertias["data"]
    assert field["x"] == pytest.approx([-28.648, 0.0, 28.648])
    assert np.sort(np.ravel(field["z"])) == pytest.approx(np.sort(axes_of(report)[0].identified_workspace), rel=1e-5)
    assert measured["marker"]["color"] == pytest.approx(axes_of(report)[0].measured.tolist(), rel=1e-5)

    for drawn in figures(estimate_page(content(max100, workspace=report.workspace[1:])))[:2]:
        assert drawn["data"][0]["z"][0][0] is None  # a pose that is not free


@pytest.mark.parametrize(
    ("stds", "curve", "told"),
    [((None, 1e6, 0.5, 0.1), [3, 4], "a in kg m²"), ((None, None), [], "a: not identified")],
)
def test_convergence_starts_where_the_parameter_is_determined(
    stds: tuple[float | None, ...], curve: list[int], told: str, max100: Robot
) -> None:
    steps = [(BaseParameter(name="a", value=1.0, std=std),) for std in stds]
    revisions = tuple(revision(step, ["a"], n) for n, step in enumerate(steps, start=1))
    estimate = content(max100).estimate.model_copy(update={"base_parameters": steps[-1]})
    found = figures(estimate_page(content(max100, estimate=estimate, revisions=revisions)))
    assert [t["x"] for f in found for t in f["data"] if t.get("name") == "a"] == [curve]
    assert told in [one["text"] for figure in found for one in figure["layout"].get("annotations", [])]


def test_example_sweep_in_time_and_frequency(max100: Robot) -> None:
    found = figures(estimate_page(content(max100, example=sweep())))
    excited = [t for f in found for t in f["data"] if t.get("name") == "velocity, excited"]
    assert excited[0]["x"] == [2.0]
    assert excited[0]["y"] == pytest.approx([4.0], rel=1e-3)  # mrad/s


def test_truth_and_what_is_not_determined(max100: Robot) -> None:
    unknown = (BaseParameter(name="</script>", value=1.0, std=None),)
    changes = {"condition_number": None, "base_parameters": unknown}
    truth = {"truth_columns": AXES, "truth": (TruthRow("ours", ("0.1", "0.2", "0.3")),)}
    estimate = content(max100).estimate.model_copy(update=changes)
    page = estimate_page(content(max100, estimate=estimate, **truth)).html()
    assert "<td>0.3</td>" in page
    assert "</script>" not in page
    assert "&lt;/script&gt;" in page


@pytest.mark.slow
def test_a_linear_axis_has_its_own_units(max100: Robot) -> None:
    urdf = max100.urdf_text
    for joint in ("joint_1", "joint_3"):
        urdf = urdf.replace(f'name="{joint}" type="revolute"', f'name="{joint}" type="prismatic"')
    rail = build_robot(max100.description, urdf)
    page = estimate_page(content(rail, example=sweep()))
    drawn = figures(page)
    layout = drawn[1]["layout"]
    assert drawn[1]["data"][0]["colorbar"]["title"]["text"] == "kg"
    assert [layout[axis]["title"]["text"] for axis in ("xaxis", "yaxis")] == ["joint_2 in deg", "joint_3 in mm"]
    assert drawn[1]["data"][2]["y"][:2] == [-1000.0, 0.0]
    scales = (pair for figure in drawn for pair in figure["layout"].items())
    titles = {words["title"]["text"] for name, words in scales if name.startswith(("xaxis", "yaxis"))}
    assert {"velocity in mm/s", "effort in N", "J measured in kg or kg m²"} <= titles
    assert not titles & {"velocity in mrad/s", "effort in N m"}
    assert "in pose (0 mm, 0°, 0 mm, 0°, 0°, 0°): a slow motion" in page.html()


@pytest.mark.parametrize(
    ("name", "unit"),
    [
        ("m(carriage) + Jm(rail)", "kg"),
        ("mz(link_2) + 0.85 m(link_3)", "kg m"),
        ("Ixx(link_2) - Izz(link_2)", "kg m²"),
        ("Jm(joint_6)", "kg m²"),
    ],
)
def test_the_unit_of_a_base_parameter(name: str, unit: str) -> None:
    assert parameter_unit(name) == unit


@pytest.fixture(scope="module")
def found() -> InitialAnalysis:
    return analysis(noise=1e-5)


def test_amplitude_responses_show_every_pose_twice(found: InitialAnalysis) -> None:
    drawn: Any = amplitude_responses(found)["data"]
    assert len(drawn) == 2 * len(LOADS)
    dots, fitted = ((np.array(one["x"], dtype=float), np.array(one["y"], dtype=float)) for one in drawn[:2])
    assert dots[0] == pytest.approx(FREQUENCY, rel=1e-5)
    assert dots[1] == pytest.approx(1 / np.abs(found.poses[0].response.impedance), rel=1e-5)
    assert np.interp(8.0, *fitted) == pytest.approx(np.interp(8.0, *dots), rel=0.05)


def test_ideal_frequencies_have_an_upright_at_each_end_and_between(found: InitialAnalysis) -> None:
    layout: Any = ideal_frequencies(found)["layout"]
    first = [shape["x0"] for shape in layout["shapes"] if shape["xref"] == "x"]
    corner, ideal, resonance = first
    assert ideal == pytest.approx(np.sqrt(corner * resonance))
    assert len(layout["annotations"]) == len(LOADS)
    assert layout["annotations"][0]["text"].startswith("J = 198 kg m²")


def test_what_lies_above_the_band_is_not_told_to_a_tenth() -> None:
    stiff = analysis(train=STIFF)
    _, rows = table({"j1": stiff}, ("j1",))
    for row in rows:
        assert row[3] == "above 39"
        assert re.fullmatch(r"above \d\.\d\d → [2345]", row[5])
    layout: Any = ideal_frequencies(stiff)["layout"]
    texts = [note["text"] for note in layout["annotations"]]
    assert all(re.search(r"ideal above \d(\.\d)? Hz → [2345] Hz", text) for text in texts)


def test_the_page_holds_two_figures_an_axis_and_a_table_of_both_methods(found: InitialAnalysis) -> None:
    page = analysis_page(small_arm(), analyses_document({"j1": found}))
    assert page.html().count("<figure>") == 2
    assert ">j1</h3>" in page.html()
    (told,) = json.loads(page.written("json"))["tables"]
    assert [len(row) for row in told["rows"]] == [len(told["head"])] * len(LOADS)
    assert re.fullmatch(r"11\.57\d+ ± 0\.0+\d\d \(11\.\d\)", told["rows"][0][3])


def test_a_linear_axis_of_an_analysis_has_its_own_units(found: InitialAnalysis) -> None:
    layout: Any = ideal_frequencies(found, linear=True)["layout"]
    assert layout["annotations"][0]["text"].startswith("J = 198 kg,")
    text = json.dumps([amplitude_responses(found, linear=True), ideal_frequencies(found, linear=True)])
    assert "m/s per N" in text
    assert "kg m" not in text
    head, rows = table({"j1": found}, ("j1", "j2"), {"j1"})
    assert head[1:3] == ["pose in deg, linear axes mm", "J in kg m², linear axes kg"]
    first = found.poses[0].pose
    assert rows[0][1].split(", ")[0] == f"{1e3 * first[0]:.0f}"
