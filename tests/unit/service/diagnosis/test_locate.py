"""Where the gap is, in words, and what of it does not repeat."""

from collections.abc import Sequence
from functools import cache

import numpy as np
import pytest

from service.diagnosis.diagnose import diagnose_axis
from service.diagnosis.fit.equations import Equations, Term, nominal_right
from service.diagnosis.localisation.locate import lines, sentences
from service.diagnosis.localisation.repeatability import Unrepeated, unrepeated
from service.diagnosis.rows.signals import tracks
from service.identification.design.diagnosis_sweeps import full_design
from service.model import Sweep
from service.model.results.diagnosis import Cell
from tests.numeric.campaign import max100
from tests.unit.service.diagnosis.following import FORWARD, RATE, SLOW, equations_of, following, swept

POSES = np.array([[0.0, -1.0, 0.2, 0, 0, 0], [0.0, 0.3, 0.2, 0, 0, 0], [0.0, 1.2, 0.2, 0, 0, 0]])


def cell(dimension: str, value: str, rms: float) -> Cell:
    return Cell(dimension=dimension, value=value, rms=rms, significance=100.0 * rms, rms_after=0.0)


def test_the_pattern_comes_first_and_what_it_says_is_not_said_twice() -> None:
    found = [cell("weight", "upwards", 1.0), cell("weight", "downwards", 20.0)]
    found += [cell("|gravity torque|", f"{k}e2 to {k + 1}e2 N m", 4.0 + 3 * k) for k in (2, 0, 1, 3)]
    found += [cell("block", "reversal", 30.0), *(cell("block", name, 5.0) for name in ("wide", "forward_slow"))]
    assert sentences("joint_2", found) == (
        "joint_2: only when moving downwards, grows with |gravity torque|.",
        "joint_2: the gap is largest at block reversal (30 against 17.8).",
    )


def test_a_gap_that_is_everywhere_alike_has_no_pattern() -> None:
    found = [cell("direction", "forward", 10.0), cell("direction", "backward", 9.0)]
    found += [cell("speed", f"{k} to {k + 1} rad/s", rms) for k, rms in enumerate((9.0, 11.0, 9.5, 10.0))]
    assert sentences("joint_1", found) == ("joint_1: the gap is about the same everywhere.",)


@pytest.mark.slow
def test_what_is_said_of_real_sweeps_is_what_their_cells_show() -> None:
    """Friction that grows with the load is a gap where the axis is slow: at speed, viscous friction passes for it."""
    robot = max100()
    hidden = {Term("load_dependent_friction", (1.0,)): (30.0, 0.05, 0.0)}
    found = diagnose_axis(robot, "joint_2", swept("joint_2", POSES, hidden, blocks=SLOW), twin=False)
    speeds = [one for one in found.cells if one.dimension == "speed"]
    largest = max(speeds, key=lambda one: one.rms)
    assert float(largest.value.split()[0]) == min(float(one.value.split()[0]) for one in speeds)
    assert f"joint_2: the gap is largest at speed {largest.value} ({largest.rms:.3g} against " in found.sentences[0]
    assert {one.value for one in found.cells if one.dimension == "weight"} == {"upwards", "downwards"}


def test_noise_has_no_lines_and_a_line_stands_out_of_it() -> None:
    """One sweep in one pose, nothing repeated: the bins between the lines tell what chance makes of one."""
    robot = max100()
    designed = full_design(robot, "joint_2", POSES[:1], blocks=FORWARD, sample_rate=RATE)[:1]
    chance = [cell for seed in range(10) for cell in line_cells(following(robot, "joint_2", designed, seed=seed))]
    assert len(chance) == 10 * len(designed[0].spec.sines)
    assert max(cell.significance for cell in chance) < 4.0
    assert abs(np.median([cell.significance for cell in chance])) < 0.8
    delayed = following(robot, "joint_2", designed, {Term("measurement_delay", (4e-3,)): (4e-3,)})
    assert max(cell.significance for cell in line_cells(delayed)) > 5.0


def test_a_line_that_is_quieter_than_all_beside_it_is_still_a_number() -> None:
    robot = max100()
    designed = full_design(robot, "joint_2", POSES[:1], blocks=FORWARD, sample_rate=RATE)[:1]
    motion = tracks(robot, "joint_2", following(robot, "joint_2", designed))
    every = np.arange(motion.usable.shape[1]) * 2 / motion.rate
    beside = np.sin(2 * np.pi * (2.0 + 1 / 3) * every)[None]  # of 3 periods of 1 s: between the lines, none at them
    assert all(np.isfinite(cell.significance) for cell in lines(motion, beside, beside))


def line_cells(sweeps: Sequence[Sweep]) -> tuple[Cell, ...]:
    """Of what CAD leaves of the effort."""
    motion = tracks(max100(), "joint_2", sweeps)
    left = motion.rows(nominal_right(motion))
    return lines(motion, left, left)


TWO = np.array([[0.0, -0.8, 0.3, 0, 0, 0], [0.0, 0.9, 0.9, 0, 0, 0]])


@cache
def quiet() -> Equations:
    robot = max100()
    return equations_of(robot, "joint_2", swept("joint_2", TWO, blocks=SLOW))


def seen(left: np.ndarray) -> Unrepeated:
    found = unrepeated(quiet(), left)
    assert found is not None
    return found


def noise(colour: float) -> np.ndarray:
    """Rows of the sensor's RMS times `colour`, correlated over a few rows."""
    white = np.random.default_rng(2).standard_normal((quiet().right.shape[0], quiet().right.shape[1] + 3))
    smooth = np.sum([white[:, k : k + quiet().right.shape[1]] for k in range(4)], axis=0) / 2.0
    return colour * quiet().sensor_noise * smooth


def test_a_vibration_that_comes_with_any_phase_is_told_with_its_frequency() -> None:
    given = quiet()
    time = np.arange(given.right.shape[1]) * 2 / given.tracks.rate
    phases = np.random.default_rng(3).uniform(0, 2 * np.pi, len(given.right))[:, None]
    amplitude = 10 * given.sensor_noise
    found = seen(amplitude * np.sin(2 * np.pi * 7.3 * time + phases) + noise(1.0))
    assert found.is_physical
    assert found.frequency == pytest.approx(7.3, abs=0.05)
    assert found.rms == pytest.approx(amplitude / np.sqrt(2), rel=0.3)
    assert "7.3 Hz" in found.sentence("joint_2", "N m")


def test_coloured_sensor_noise_is_no_machine() -> None:
    found = seen(noise(2.0))
    assert found.rms == pytest.approx(2 * found.sensor_rms, rel=0.1)
    assert not found.is_physical
    assert found.frequency is None


def test_what_repeats_is_not_its_matter() -> None:
    left = np.broadcast_to(1e3 * np.sin(np.arange(quiet().right.shape[1]) / 9.0), quiet().right.shape)
    found = unrepeated(quiet(), np.array(left))
    assert found is None or found.rms < 1e-6
