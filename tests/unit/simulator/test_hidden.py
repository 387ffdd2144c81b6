"""What `--hide` puts into a machine, told to nobody; and what `sweepid drive truth` tells."""

import json
import subprocess
import sys
from dataclasses import asdict
from pathlib import Path

import pytest

from service.diagnosis.effects import CATALOGUE
from simulator import ScenarioError, load_scenario, true_inertia
from simulator.hidden import EFFECTS, hide
from tests.command import sweepid

ROOT = Path(__file__).parents[3]
MODELLED = ROOT / "config" / "scenarios" / "max100-as-modelled.yaml"
FULL = MODELLED.with_stem("max100-full")
SEEDS = range(100)


@pytest.mark.slow
def test_the_seed_decides_and_every_effect_comes_up() -> None:
    scenario = load_scenario(MODELLED)
    found = [hide(scenario, seed) for seed in SEEDS]
    assert [hide(scenario, seed) for seed in SEEDS[:5]] == found[:5]
    assert {hidden.effect for _, hidden in found} == set(EFFECTS)
    assert {hidden.joint for _, hidden in found} == {"joint_2", "joint_3"}  # axis 1 carries no weight


def test_effects_have_the_names_that_a_diagnosis_gives_them() -> None:
    assert set(EFFECTS) < set(CATALOGUE)


@pytest.mark.parametrize("seed", SEEDS[:40])
def test_one_thing_is_changed_and_nothing_else(seed: int) -> None:
    before = load_scenario(MODELLED)
    after, hidden = hide(before, seed)
    changed = {
        (joint, name)
        for joint, axis in after.axes.items()
        for name, value in axis.train
        if value != getattr(before.axes[joint].train, name)
    }
    everywhere = {joint for joint, _ in changed}
    if hidden.effect == "joint_elasticity":  # the other gears get springs that nobody sees
        assert changed == {(joint, "spring") for joint in before.axes}
        stiffest = max(axis.train.spring.stiffness for axis in after.axes.values() if axis.train.spring)
        assert 1 / hidden.parameters["compliance"] < 0.05 * stiffest
    else:
        assert everywhere <= {hidden.joint}
    elsewhere = [after.links != before.links, after.measurement != before.measurement, bool(changed)]
    assert sum(elsewhere) == 1


def test_a_machine_without_weight_hides_nothing() -> None:
    scenario = load_scenario(MODELLED)
    upright = scenario.model_copy(update={"axes": {"joint_1": scenario.axes["joint_1"]}})
    with pytest.raises(ScenarioError, match="no axis carries weight"):
        hide(upright, 0)


def test_the_truth_is_told_by_its_own_command() -> None:
    told = sweepid("drive", "truth", str(MODELLED), "--hide", "3")
    assert told.returncode == 0
    assert json.loads(told.stdout) == asdict(hide(load_scenario(MODELLED), 3)[1])


def test_it_prints_the_inertia_of_every_moving_joint(tmp_path: Path) -> None:
    poses = [[0.0] * 6, [0.0, 1.0, -0.5, 0.0, 0.0, 0.0]]
    (tmp_path / "poses.json").write_text(json.dumps(poses))
    told = sweepid("drive", "truth", str(FULL), "--poses", str(tmp_path / "poses.json"))
    found = json.loads(told.stdout)
    assert list(found) == ["joint_1", "joint_2", "joint_3"]
    assert found["joint_2"] == true_inertia(load_scenario(FULL), "joint_2", poses).tolist()


@pytest.mark.parametrize(
    ("text", "options", "reason"),
    [
        ("{", ("--poses",), "not a list of poses"),
        ("[[0, 1]]", ("--poses",), "(1, 2)"),
        ("7", ("--poses",), "poses"),
        ("", (), "exactly one of --poses and --hide"),
        ("", ("--hide", "3", "--poses"), "exactly one of --poses and --hide"),
    ],
)
def test_what_cannot_be_told_is_refused_in_one_line(
    tmp_path: Path, text: str, options: tuple[str, ...], reason: str
) -> None:
    file = tmp_path / "poses.json"
    file.write_text(text)
    told = sweepid("drive", "truth", str(FULL), *options, *([str(file)] if options else []))
    assert (told.returncode, told.stdout) == (2, "")
    assert reason in told.stderr
    assert told.stderr.count("\n") == 1


@pytest.mark.slow
def test_the_machine_says_on_which_axis_and_no_more() -> None:
    command = [str(Path(sys.executable).with_name("sweepid")), "drive", "--port", "0", "--scenario", str(MODELLED)]
    command += ["--eds", str(ROOT / "config" / "eds" / "virtual-axis.eds"), "--hide", "3"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True) as process:
        assert process.stdout is not None
        ready = json.loads(process.stdout.readline())
        process.terminate()
    _, hidden = hide(load_scenario(MODELLED), 3)
    assert ready.pop("hidden_in") == hidden.joint
    assert set(ready) == {"ready", "fieldbus", "port", "control_port"}
