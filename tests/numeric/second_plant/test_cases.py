"""What cases hold and what they keep back; a few of them through the scorer. `score` runs them all."""

import ast
from pathlib import Path

import numpy as np
import pytest

from service.diagnosis.effects import CATALOGUE as NAMES
from service.model import Robot, Sweep
from tests.numeric.second_plant.cases import Case, Kind, Truth, case, cases, make
from tests.numeric.second_plant.effects import CATALOGUE
from tests.numeric.second_plant.faults import FAULTS
from tests.numeric.second_plant.kept import load, save
from tests.numeric.second_plant.outside import OUTSIDE

HERE = Path(__file__).parent
MAY_COMPUTE = {
    "score.py",
    "scoring.py",
    "page.py",
    "loop.py",
    "robot_time.py",
}  # they judge; the plant is all else but the tests
FOREIGN = ("simulator", "service.identification", "service.diagnosis", "service.cli")


def foreign(text: str) -> list[str]:
    """Imports of a file that bring in what computes elsewhere."""
    names: list[str] = []
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.ImportFrom):
            names += [f"{node.module}.{alias.name}" for alias in node.names]
        elif isinstance(node, ast.Import):
            names += [alias.name for alias in node.names]
    return [name for name in names if any(name == f or name.startswith(f + ".") for f in FOREIGN)]


def test_the_plant_shares_nothing_that_computes() -> None:
    plant = [p for p in HERE.glob("*.py") if p.name not in MAY_COMPUTE and not p.name.startswith("test_")]
    assert len(plant) > 10
    assert {path.name: foreign(path.read_text()) for path in plant} == {path.name: [] for path in plant}


def test_more_cases_leave_the_others_as_they_were() -> None:
    few = cases(3, singles=1, none=2, pairs=3, triples=2, outside=5, nominal=4)
    many = cases(3, singles=2, none=9, pairs=7, triples=6, outside=20, nominal=30, sizes=("small", "medium", "large"))
    assert set(few) <= set(many)
    assert len({one.number for one in many}) == len(many)
    singles = {(one.names[0], one.size) for one in many if one.kind is Kind.SINGLE}
    assert singles == {(name, size) for name in NAMES for size in ("small", "medium", "large")}
    assert {one.names[0] for one in many if one.kind is Kind.OUTSIDE} == set(OUTSIDE)
    assert {one.names[0] for one in many if one.kind is Kind.NOMINAL} == set(FAULTS)


def test_a_seed_makes_the_same_case_again() -> None:
    one = case(9, 4, Kind.PAIR, ("coulomb_friction", "cogging_torque"), "large")
    first, again, other = (
        make(one, small=True),
        make(one, small=True),
        make(Case(9, 5, one.kind, one.names), small=True),
    )
    assert first[3] == again[3]
    for a, b in zip(first[2], again[2], strict=True):
        np.testing.assert_array_equal(a.recording.effort, b.recording.effort)
    assert first[0].urdf_text == again[0].urdf_text != other[0].urdf_text


def test_what_is_kept_are_the_sweeps_and_no_truth(tmp_path: Path) -> None:
    robot, joint, sweeps, truth = make(case(9, 6, Kind.SINGLE, ("payload",)), small=True)
    save(tmp_path / "6.npz", robot, joint, sweeps)
    robot_again, joint_again, again = load(tmp_path / "6.npz")
    assert (robot_again.description, joint_again) == (robot.description, joint)
    for a, b in zip(sweeps, again, strict=True):
        assert a.spec == b.spec
        np.testing.assert_array_equal(a.recording.effort, b.recording.effort)
    mass = truth.hidden["payload"]["mass"]
    kept = (tmp_path / "6.npz").read_bytes()
    assert f"{mass:.6g}".encode() not in kept
    assert np.float64(mass).tobytes() not in kept


def rows(robot: Robot, sweeps: tuple[Sweep, ...], joint: str, truth: Truth) -> tuple[np.ndarray, np.ndarray]:
    """Acceleration, speed, jerk, weight (two), sign of the speed; and the torque, in the first pose's window."""
    rate, columns, effort = truth.sample_rate, [], []
    for sweep in sweeps:
        spec, record = sweep.spec, sweep.recording
        if spec.pose != sweeps[0].spec.pose or not spec.offset_velocity:
            continue
        window = slice(round(rate), round(3 * rate))
        v, q = record.velocity[window], record.position[window]
        frequency = np.fft.rfftfreq(v.size, 1 / rate)
        line = np.where(frequency < 25, np.fft.rfft(v - v.mean()), 0)
        swing = 2j * np.pi * frequency
        a, jerk = (np.fft.irfft(swing**k * line, v.size) for k in (1, 2))
        columns.append(np.column_stack([a, v, jerk, np.cos(q), np.sin(q), np.sign(v)]))
        effort.append(record.effort[window])
    return np.vstack(columns), np.concatenate(effort)


def test_what_is_measured_is_what_was_given() -> None:
    """A regression by hand: inertia, viscous friction, Coulomb level, delay; what is left is the noise."""
    healthy = make(case(31, 1, Kind.NONE, (), "none"))
    matrix, effort = rows(healthy[0], healthy[2], healthy[1], healthy[3])
    found, *_ = np.linalg.lstsq(matrix[:, :5], effort)
    truth = healthy[3]
    assert found[0] == pytest.approx(truth.J_true[2], rel=3e-3)
    assert found[1] == pytest.approx(truth.viscous_true, rel=3e-2)
    assert -found[2] / found[0] == pytest.approx(0.0, abs=5e-5)
    assert (effort - matrix[:, :5] @ found).std() == pytest.approx(truth.noise_floor, rel=0.1)

    dry = make(case(31, 2, Kind.SINGLE, ("coulomb_friction",), "large"))
    matrix, effort = rows(dry[0], dry[2], dry[1], dry[3])
    found, *_ = np.linalg.lstsq(matrix, effort)
    assert found[5] == pytest.approx(dry[3].hidden["coulomb_friction"]["level"], rel=2e-2)

    late = make(case(31, 3, Kind.SINGLE, ("measurement_delay",), "medium"))
    matrix, effort = rows(late[0], late[2], late[1], late[3])
    found, *_ = np.linalg.lstsq(matrix[:, :5], effort)
    assert -found[2] / found[0] == pytest.approx(late[3].hidden["measurement_delay"]["delay"], rel=5e-2)


@pytest.mark.parametrize("name", sorted(CATALOGUE | OUTSIDE))
def test_a_large_effect_is_seen_and_no_monster(name: str) -> None:
    """Against the same machine with nothing hidden: well above the noise, below the rated effort."""
    one = Case(41, 1, Kind.OUTSIDE if name in OUTSIDE else Kind.SINGLE, (name,), "large")
    hidden, bare = make(one, small=True), make(one, small=True, bare=True)
    pairs = zip(hidden[2], bare[2], strict=True)
    away = np.array([a.recording.effort - b.recording.effort for a, b in pairs])
    truth = hidden[3]
    assert float(np.percentile(np.abs(away), 99)) > 6 * truth.noise_floor
    assert float(np.abs(away).max()) < 1.5 * truth.rated_effort
    assert set(truth.hidden) == {name}
