"""`sweepid diagnose` as a person calls it: a table or JSON on stdout, one line and exit code 2 for bad input."""

import hashlib
import json
from pathlib import Path

import numpy as np
import pytest

from service.diagnosis.rows.signals import in_frequency
from service.diagnosis.sensitivity import expected
from service.identification.design.diagnosis_sweeps import full_design
from service.model import Sweep
from service.store.files.bundle import write_bundle
from simulator import load_scenario
from tests.command import carried_out, refused, sweepid
from tests.numeric.campaign import max100

pytestmark = pytest.mark.slow

FRICTION = 60.0  # N m, dry, that the model does not know


@pytest.fixture(scope="module")
def bundle(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The vertical axis of the representative robot, with dry friction and 3 N m of noise."""
    robot, random = max100(), np.random.default_rng(5)
    poses = np.array([[0.0, -0.6, 0.4, 0, 0, 0], [0.5, 0.4, -0.7, 0, 0, 0], [-0.5, 0.0, 0.0, 0, 0, 0]])
    sweeps: list[Sweep] = []
    for designed in full_design(robot, "joint_1", poses, sample_rate=250.0):
        sweep = expected(designed, designed.spec.pose[0])
        record = sweep.recording
        # a difference quotient would look like a spring
        (turning,) = in_frequency(record.velocity[None], 250.0)
        effort = 300.0 * turning + 200.0 * record.velocity + FRICTION * np.sign(record.velocity)
        record.effort[:] = effort + random.normal(0, 3.0, len(effort))
        sweeps.append(sweep)
    folder = tmp_path_factory.mktemp("diagnose") / "bundle"
    write_bundle(folder, robot, sweeps)
    return folder


def test_json_alone_on_stdout(bundle: Path) -> None:
    document = json.loads(carried_out("diagnose", str(bundle), "--json", "-"))
    assert set(document) == {"axes", "model"}
    axis = document["axes"]["joint_1"]
    contract = {"verdict", "effects", "candidates", "where", "gap", "next_experiment", "untestable"}
    assert contract <= set(axis)
    assert [effect["effect"] for effect in axis["effects"]] == ["coulomb_friction"]
    coulomb = axis["effects"][0]["parameters"]["coulomb"]
    assert coulomb["value"] == pytest.approx(FRICTION, abs=1.0)
    assert axis["gap"]["after_rms"] < 0.1 * axis["gap"]["before_rms"]
    assert (axis["gap"]["source"], axis["rolled_back"]) == ("columns", [])
    assert axis["gap"]["twin_rms"] < 0.1 * axis["gap"]["before_rms"]
    assert axis["rigid_model"][-1]["name"] == "viscous_friction"
    assert axis["rigid_model"][-1]["value"] == pytest.approx(200.0, abs=20.0)


def test_words_for_people(bundle: Path) -> None:
    told = carried_out("diagnose", str(bundle), "--axis", "joint_1")
    for word in ("joint_1", "named", "coulomb_friction", "Dry friction of the same size", "rigid model"):
        assert word in told


def test_the_model_and_its_machine_are_written(bundle: Path, tmp_path: Path) -> None:
    model, scenario = tmp_path / "model.json", tmp_path / "twin.yaml"
    carried_out("diagnose", str(bundle), "--no-twin", "--model", str(model), "--scenario", str(scenario))
    axis = json.loads(model.read_text())["axes"]["joint_1"]
    assert [effect["effect"] for effect in axis["effects"]] == ["coulomb_friction"]
    assert axis["fit"]["inertia"][0]["value"] == pytest.approx(300.0, abs=1.0)
    friction = load_scenario(scenario).driven("joint_1").train.motor_friction
    assert (friction.coulomb, friction.viscous) == (pytest.approx(FRICTION, abs=1.0), pytest.approx(200.0, abs=20.0))


def test_the_rigid_model_starts_from_an_estimate_and_says_so(bundle: Path, tmp_path: Path) -> None:
    estimate = tmp_path / "estimate.json"
    assert sweepid("identify", str(bundle), "--json", str(estimate)).returncode == 0
    done = sweepid("diagnose", str(bundle), "--no-twin", "--estimate", str(estimate), "--json", "-")
    assert done.returncode == 0, done.stderr
    axis = json.loads(done.stdout)["axes"]["joint_1"]
    assert axis["started_from"] == f"estimate.json, sha256 {hashlib.sha256(estimate.read_bytes()).hexdigest()}"
    words = sweepid("diagnose", str(bundle), "--no-twin", "--estimate", str(estimate))
    assert "The rigid model started from estimate.json" in words.stdout


@pytest.mark.parametrize(
    ("text", "arguments", "reason"),
    [
        ("{}", ["--estimate", "estimate.json"], "estimate.json.axes"),
        ("", ["--axis", "joint_9"], "joint_9: unknown joint"),
        ("", ["--axis", "joint_2"], "has no sweep that moves joint joint_2 alone: measure it"),
        ("", ["--known", "magic"], "magic: unknown effect"),
    ],
)
def test_bad_input_is_one_line_and_two(
    bundle: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, text: str, arguments: list[str], reason: str
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "estimate.json").write_text(text)
    assert reason in refused("diagnose", str(bundle), *arguments).splitlines()[-1]
