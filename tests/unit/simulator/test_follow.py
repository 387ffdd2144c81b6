"""A path under position control: what feed-forward takes off the controllers, and what is refused."""

import json
from pathlib import Path

import numpy as np
import pytest

from simulator.follow import Path as Wanted, follow
from simulator.rigid_body import true_inertia
from simulator.scenario import ScenarioError, load_scenario
from tests.command import sweepid

pytestmark = pytest.mark.slow

TIME = np.arange(401) * 1e-3  # s
TURN = 2 * np.pi / TIME[-1]


@pytest.fixture(scope="module")
def scenario_file(root: Path) -> Path:
    return root / "config/scenarios/max100-full.yaml"


def vertical() -> tuple[Wanted, np.ndarray]:
    """A short turn of the first axis alone, and its acceleration (n,)."""
    position, velocity = np.zeros((2, len(TIME), 6))
    size = 0.02
    position[:, 0] = size * (TIME / TIME[-1] - np.sin(TURN * TIME) / (2 * np.pi))
    velocity[:, 0] = size / TIME[-1] * (1 - np.cos(TURN * TIME))
    return Wanted(position, velocity), size / TIME[-1] * TURN * np.sin(TURN * TIME)


def test_the_true_inertia_fed_forward_leaves_friction_alone(scenario_file: Path) -> None:
    scenario = load_scenario(scenario_file)
    path, acceleration = vertical()
    (inertia,) = true_inertia(scenario, "joint_1", np.zeros((1, 6)))
    speed = path.velocity[:, 0]
    rms = {
        name: float(np.sqrt(np.mean(follow(scenario, path, 10.0, _first(effort))["joint_1"] ** 2)))
        for name, effort in (
            ("nothing", np.zeros_like(TIME)),
            ("inertia", inertia * acceleration),
            ("friction too", inertia * acceleration + 200 * speed + 130 * np.sign(speed)),  # of the scenario
        )
    }
    assert rms["friction too"] < rms["inertia"] / 2 < rms["nothing"]
    assert rms["friction too"] < 0.1 * rms["nothing"]


def test_joints_that_stand_stay_where_they_are(scenario_file: Path) -> None:
    errors = follow(load_scenario(scenario_file), vertical()[0], 10.0)
    assert set(errors) == {"joint_1", "joint_2", "joint_3"}
    assert np.abs(errors["joint_2"]).max() < 1e-5  # rad, held by brake-free controllers


def _first(effort: np.ndarray) -> np.ndarray:
    return np.stack([effort, *[np.zeros_like(effort)] * 5], axis=1)


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ({"position": [[0.0] * 5, [0.0] * 5]}, "needs positions and velocities of 6 joints"),
        ({"position": [[0.0] * 6, [0.0] * 5 + [1.0]]}, "joint_6 has no drive"),
        ({"position": [[0.0] * 6, [0.0]]}, "position: rows of different lengths"),
        ({"feed_forwards": {"cad": [[0.0] * 6]}}, "the feed-forward is not 2 rows of 6 numbers"),
        ({"gain": 0}, "gain"),
    ],
)
def test_what_does_not_fit_is_refused_in_one_line(
    change: dict[str, object], told: str, scenario_file: Path, tmp_path: Path
) -> None:
    still = [[0.0] * 6] * 2
    file = {"gain": 10.0, "position": still, "velocity": still, "feed_forwards": {"none": []}} | change
    (tmp_path / "path.json").write_text(json.dumps(file))
    done = sweepid("drive", "follow", str(scenario_file), str(tmp_path / "path.json"))
    assert done.returncode == 2
    assert told in done.stderr
    assert done.stdout == ""


def test_the_command_tells_each_feed_forward(scenario_file: Path, tmp_path: Path) -> None:
    still = [[0.0] * 6] * 3
    file = {"gain": 10.0, "position": still, "velocity": still, "feed_forwards": {"none": [], "held": still}}
    (tmp_path / "path.json").write_text(json.dumps(file))
    done = sweepid("drive", "follow", str(scenario_file), str(tmp_path / "path.json"))
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    assert found["none"] == found["held"]
    assert found["none"]["joint_3"]["peak"] < 1e-6


def test_a_number_that_is_none_is_refused(scenario_file: Path) -> None:
    path, _ = vertical()
    bad = path.position.copy()
    bad[3, 0] = np.nan
    with pytest.raises(ScenarioError, match="not finite"):
        follow(load_scenario(scenario_file), Wanted(bad, path.velocity), 10.0)
