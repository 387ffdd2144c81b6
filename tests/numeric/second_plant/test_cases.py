"""What cases hold and what they keep back; a few of them through the scorer. `score` runs them all."""

import ast
import json
from pathlib import Path

import numpy as np
import pytest

from service.recording import Sweep
from service.robot import Robot
from service.store.files.bundle import read_bundle
from tests.numeric.second_plant.build import Wanted, build
from tests.numeric.second_plant.cases import Case, Kind, Truth, case, cases, make, write
from tests.numeric.second_plant.effects import CATALOGUE
from tests.numeric.second_plant.faults import FAULTS
from tests.numeric.second_plant.kept import load, save
from tests.numeric.second_plant.outside import OUTSIDE

HERE = Path(__file__).parent
MAY_COMPUTE = {"score.py", "scoring.py", "page.py"}  # they judge; the plant is all else but the tests
FOREIGN = ("simulator", "service.identification", "service.diagnosis", "service.cli", "service.estimation")
DESIGN = (
    "coulomb_friction", "asymmetric_friction", "stribeck_friction", "nonlinear_viscous_friction",
    "load_dependent_friction", "friction_temperature_drift", "gravity_error", "hose_spring", "joint_elasticity",
    "measurement_delay", "cogging_torque", "transmission_error", "presliding_hysteresis", "backlash", "effort_offset",
    "torque_constant_error", "payload",
)  # fmt: skip


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


@pytest.mark.parametrize(
    "line",
    ["import simulator", "from simulator.rigid_body import RigidBody", "from service.diagnosis import effects",
     "from service import diagnosis", "def f():\n    import service.identification.model.regressor"],
)  # fmt: skip
def test_a_planted_import_is_seen(line: str) -> None:
    path = HERE / "friction.py"
    assert foreign(f"{path.read_text()}\n{line}\n")


def test_all_names_of_the_design_are_hidden_in_every_size() -> None:
    assert tuple(CATALOGUE) == DESIGN
    some = cases(3, singles=2, sizes=("small", "medium", "large"))
    assert {(one.names[0], one.size) for one in some} == {(n, s) for n in DESIGN for s in ("small", "medium", "large")}
    assert len(some) == len({one.number for one in some}) == 2 * 3 * len(DESIGN)


def test_more_cases_leave_the_others_as_they_were() -> None:
    few = cases(3, singles=1, none=2, pairs=3, triples=2, outside=5, nominal=4)
    many = cases(3, singles=2, none=9, pairs=7, triples=6, outside=20, nominal=30, sizes=("small", "medium", "large"))
    assert set(few) <= set(many)
    assert len({one.number for one in many}) == len(many)
    assert {one.names[0] for one in many if one.kind is Kind.OUTSIDE} == set(OUTSIDE)
    assert {one.names[0] for one in many if one.kind is Kind.NOMINAL} == set(FAULTS)


def test_a_name_of_another_kind_is_refused() -> None:
    with pytest.raises(ValueError, match="floor_vibration"):
        case(1, 1, Kind.SINGLE, ("floor_vibration",))


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


def test_the_bundle_holds_no_truth(tmp_path: Path) -> None:
    one = case(9, 6, Kind.SINGLE, ("payload",), "medium")
    place = write(one, tmp_path, small=True)
    robot, joint, sweeps, truth = make(one, small=True)
    told = read_bundle(place)
    assert told.robot.description == robot.description
    np.testing.assert_array_equal(told.sweeps[7].recording.velocity, sweeps[7].recording.velocity)
    kept = json.loads((tmp_path / "truth" / "00006.json").read_text())
    foreign_keys = {"axis", "hidden", "companions", "prior", "cad_off_by", "viscous_true", "J_true"}
    assert foreign_keys | {"size", "seed", "class"} <= set(kept)
    assert (kept["axis"], kept["class"]) == (joint, "single")
    mass = f"{truth.hidden['payload']['mass']:.6g}"
    assert not any(mass.encode() in path.read_bytes() for path in place.rglob("*.*"))


def test_sweeps_kept_are_the_sweeps(tmp_path: Path) -> None:
    robot, joint, sweeps, _ = make(case(9, 7, Kind.NONE, (), "none"), small=True)
    save(tmp_path / "7.npz", robot, joint, sweeps)
    robot_again, joint_again, again = load(tmp_path / "7.npz")
    assert (robot_again.description, joint_again) == (robot.description, joint)
    for a, b in zip(sweeps, again, strict=True):
        assert a.spec == b.spec
        np.testing.assert_array_equal(a.recording.effort, b.recording.effort)


def test_a_design_has_what_a_diagnosis_needs() -> None:
    _, _, sweeps, truth = make(case(9, 8, Kind.NONE, (), "none"))
    specs = [sweep.spec for sweep in sweeps]
    assert specs[0].excitation == specs[1].excitation == "standstill"
    moving = specs[2:]
    assert {spec.offset_velocity > 0 for spec in moving} == {True, False}
    assert any(spec.offset_velocity == 0 for spec in moving)
    assert max(sine.frequency for spec in moving for sine in spec.sines) >= 16
    assert len({spec.pose for spec in moving}) >= 3
    assert moving[-1].pose == moving[0].pose
    assert [spec.repeat for spec in specs] == [0, 1] * (len(specs) // 2)
    lengths = {sweep.recording.time.size / sweep.spec.sample_rate for sweep in sweeps}
    assert lengths == {3.0 if truth.records_end_with_window else 3.6}


def test_what_is_random_comes_in_the_shares_that_are_said() -> None:
    drafts = [build(np.random.default_rng((21, n)), Wanted((), "none"), "robot").draft for n in range(40)]
    assert 23 <= sum(not draft.tight for draft in drafts) <= 37
    assert 11 <= sum(draft.plan.run_out == 0 for draft in drafts) <= 29
    assert 3 <= sum(draft.sensors.effort_step > 0 for draft in drafts) <= 18
    assert {draft.plan.rate for draft in drafts} == {500.0, 1000.0, 2000.0}
    assert all(10 < j < 1500 for draft in drafts for j in draft.train.load)
    assert all(0.75 <= draft.viscous / draft.nominal_viscous <= 1.3 for draft in drafts)


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


@pytest.mark.parametrize("fault", FAULTS)
def test_a_fault_is_in_the_bundle(fault: str) -> None:
    """Told in the truth, and robot or records are not what they would be without."""
    robot, joint, sweeps, truth = make(Case(51, 1, Kind.NOMINAL, (fault,), "medium"), small=True)
    plain_robot, plain_joint, plain, _ = make(Case(51, 1, Kind.NOMINAL, (fault,), "medium"), small=True, bare=True)
    assert truth.fault == fault
    changed = [
        (a.spec.axis, a.recording.effort.tolist(), a.recording.velocity.tolist(), a.recording.position.tolist())
        != (b.spec.axis, b.recording.effort.tolist(), b.recording.velocity.tolist(), b.recording.position.tolist())
        for a, b in zip(sweeps, plain, strict=True)
    ]
    assert any(changed) or robot.description != plain_robot.description or joint != plain_joint
