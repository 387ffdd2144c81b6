"""Constants that decide results at half and at double their value: what changes, on one simulated campaign each.

`python -m tests.benchmarks.constants [NAME ...]` prints the figures and writes results/constants.json; `table` makes
the table of docs/reference/constants.md from it. A minute of processor time.
Where a constant must be a whole number, half is rounded up. The module's constant is replaced while one case runs.
"""

import json
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np

from service.errors import BadInput
from service.identification import Estimate, identify, spectrum
from service.identification.axis import joint_fit, outliers
from service.identification.design import excitation, pose_selection
from service.identification.design.halton import spread_evenly
from service.identification.design.pose_selection import Criterion, select_poses
from service.identification.estimates import estimate as estimates
from service.identification.model import least_squares
from service.identification.model.base_parameters import base_parameters, joint_ranges
from service.identification.model.regressor import lock
from service.identification.spectra import frequency_response, speed_loop
from simulator import true_inertia
from tests.numeric.campaign import AXES, SimulatedCampaign, max100, measure

RESULTS = Path(__file__).parent / "results"
SCENARIO, SEED, POSES, FEW_POSES = "max100-full", 17, 8, 3
LIGHTER = (0.5, 1.0, 2.0)
Figures = dict[str, float]


@contextmanager
def replaced(modules: tuple[ModuleType, ...], name: str, value: Any) -> Iterator[None]:
    """A constant that has another value in every module that uses it."""
    before = [getattr(module, name) for module in modules]
    for module in modules:
        setattr(module, name, value)
    try:
        yield
    finally:
        for module, old in zip(modules, before, strict=True):
            setattr(module, name, old)


def estimated(campaign: SimulatedCampaign) -> Estimate:
    """Without the results kept of unchanged axes, which know nothing of another constant."""
    with replaced((estimates,), "unchanged_or", lambda compute, *inputs: compute(*inputs)):
        return identify(campaign.robot, [spectrum(campaign.robot, sweep) for sweep in campaign.sweeps])


def inertias(campaign: SimulatedCampaign) -> Callable[[], Figures]:
    """J of all sweeps against the truth; against the usual value of the constant as `usual` says."""
    usual = np.concatenate([axis.values for axis in estimated(campaign).axes])

    def figures() -> Figures:
        found = estimated(campaign)
        values = np.concatenate([axis.values for axis in found.axes])
        stds = np.concatenate([np.sqrt(np.diag(axis.covariance)) for axis in found.axes])
        truth = np.concatenate([campaign.truth(axis.joint) for axis in found.axes])
        return {
            "std of J, %": 100 * float(np.median(stds / values)),
            "error of J, % RMS": 100 * float(np.sqrt(np.mean((values / truth - 1) ** 2))),
            "error / std, RMS": float(np.sqrt(np.mean(((values - truth) / stds) ** 2))),
            "J moved, std": float(np.max(np.abs(values - usual) / stds)),
            "noise still changes": max(float(axis.fit.noise_change.max()) for axis in found.axes if axis.fit),
        }

    return figures


def workspace(campaign: SimulatedCampaign) -> Figures:
    """The estimate where nothing was measured."""
    found = estimated(campaign)
    poses = found.workspace
    error = [found.identified(joint, poses) / true_inertia(campaign.scenario, joint, poses) - 1 for joint in AXES]
    determined = int(np.count_nonzero(found.solution.determined))
    return {
        "error of J over the workspace, % RMS": 100 * float(np.sqrt(np.mean(np.square(error)))),
        "determined base parameters": determined,
    }


def suspicion() -> Figures:
    """Campaigns of 5 to 19 poses, one to three sweeps each: sound ones, and with one sweep off by 6 std."""
    alarms, caught = [], []
    for seed in range(400):
        rng = np.random.default_rng(seed)
        rows = np.repeat(rng.standard_normal((rng.integers(5, 20), 4)), rng.integers(1, 4), axis=0)
        rows[:, 0] += 5
        values = rows @ np.array([10.0, 1.0, 2.0, 3.0]) + 0.1 * rng.standard_normal(len(rows))
        covariance = [0.01 * np.eye(len(values))]
        alarms.append(bool(outliers.judge(rows, values, covariance).extra.any()))
        values[0] += 0.6
        caught.append(outliers.judge(rows, values, covariance).extra[0] > 0)
    return {
        "sound campaigns with a suspect, %": 100 * float(np.mean(alarms)),
        "caught, %": 100 * float(np.mean(caught)),
    }


def designed() -> Figures:
    """Sweeps designed anew and measured; the slowest that the load moves, over its offset: below 0 it reverses."""
    campaign = measure(SCENARIO, SEED, poses=4, direct_encoder=True)
    slowest: list[float] = []
    for sweep in campaign.sweeps:
        first, count = frequency_response.window(sweep.spec, sweep.recording.time)
        load = sweep.recording.load_velocity
        assert load is not None
        slowest.append(float((load[first : first + count] / sweep.spec.offset_velocity).min()))
    motors = measure(SCENARIO, SEED, poses=4)
    figures = inertias(motors)()
    return {name: figures[name] for name in ("std of J, %", "error / std, RMS")} | {
        "slowest load / offset": min(slowest)
    }


def poses_chosen() -> Figures:
    """24 of 1,500 poses of axes 1 to 3: how many differ from those of the usual value, and the condition number."""
    robot = max100()
    chain = lock(robot.chain, {3: 0.0, 4: 0.0, 5: 0.0})
    base = base_parameters(chain, (0, 1, 2))
    poses = spread_evenly(1500, *joint_ranges(chain))
    rows = np.stack([base.rows(chain, axis, poses) for axis in range(3)], axis=1)
    found = select_poses(rows, 24, Criterion.D_OPTIMAL)
    with replaced((pose_selection,), "RIDGE", 1e-6):
        usual = select_poses(rows, 24, Criterion.D_OPTIMAL)
    return {"other poses of 24": len(set(found.picks) - set(usual.picks)), "condition": found.condition[-1]}


def loops() -> Figures:
    """Speed loops with a mode at 80 Hz, 100 draws of noise."""
    frequency = np.arange(1, 256, dtype=np.float64) * (8000 / 2047)
    over_gain, s = 3.6e-3, 2j * np.pi * frequency
    train = (over_gain * s + 0.025) * np.exp(s * 0.7e-3)
    mode = 1 + 0.05 * s**2 / (s**2 + 2 * 0.05 * 500 * s + 500**2)
    errors, stds = np.zeros((2, 100))
    for seed in range(100):
        rng = np.random.default_rng(seed)
        noise = 0.02 * (rng.normal(size=len(s)) + 1j * rng.normal(size=len(s)))
        fit = speed_loop.fit_closed_loop(frequency, mode / (1 + train) + noise, "loop")
        errors[seed], stds[seed] = fit.inertia / over_gain - 1, fit.inertia_std / over_gain
    return {
        "bias of J/K, %": 100 * float(errors.mean()),
        "std of J/K, %": 100 * float(np.median(stds)),
        "within two std, %": 100 * float(np.mean(np.abs(errors) < 2 * stds)),
    }


def cases() -> dict[str, tuple[tuple[ModuleType, ...], str, tuple[Any, ...], Callable[[], Figures]]]:
    """By name on the page: modules, name in them, values, figures."""
    campaign = measure(SCENARIO, SEED, poses=POSES)
    of_sweeps = inertias(campaign)

    few = replace(
        campaign, sweeps=tuple(sweep for sweep in campaign.sweeps if (int(sweep.spec.id) - 1) % POSES < FEW_POSES)
    )

    def over_workspace() -> Figures:
        return workspace(few)

    def scaled(value: float) -> tuple[float, ...]:
        return tuple(factor * value for factor in LIGHTER)

    return {
        "joint_fit.FREE": ((joint_fit,), "FREE", scaled(joint_fit.FREE), of_sweeps),
        "joint_fit.GAINED": ((joint_fit,), "GAINED", (*scaled(joint_fit.GAINED), 1e-4), of_sweeps),
        "joint_fit.ROUNDS": ((joint_fit,), "ROUNDS", (2, 4, 8), of_sweeps),
        "frequency_response.MARGIN": (
            (frequency_response,), "MARGIN", scaled(frequency_response.MARGIN), of_sweeps,
        ),
        "frequency_response.LOW": ((frequency_response,), "LOW", scaled(frequency_response.LOW), of_sweeps),
        "least_squares.BETTER": ((least_squares,), "BETTER", scaled(least_squares.BETTER), over_workspace),
        "joint_fit.CHANCE": ((outliers,), "CHANCE", scaled(joint_fit.CHANCE), suspicion),
        "excitation.LOAD_MARGIN": ((excitation,), "LOAD_MARGIN", scaled(excitation.LOAD_MARGIN), designed),
        "excitation.SETTLE": ((excitation,), "SETTLE", scaled(excitation.SETTLE), designed),
        "pose_selection.RIDGE": ((pose_selection,), "RIDGE", scaled(pose_selection.RIDGE), poses_chosen),
        "speed_loop.FOLLOWS": ((speed_loop,), "FOLLOWS", (0.25, 0.5, 0.9), loops),
        "speed_loop.PARTS": ((speed_loop,), "PARTS", (3, 5, 10), loops),
    }  # fmt: skip


def _or_refused(figures: Callable[[], Figures]) -> Figures:
    """A fit that does not converge is refused."""
    try:
        return figures()
    except BadInput as error:
        print(f"   refused: {error}")
        return {"refused": 1.0}


def table(result: dict[str, list[dict[str, float]]]) -> str:
    """Markdown, one row a value."""
    lines = ["| constant | value | figures |", "|---|---|---|"]
    for title, found in result.items():
        for one in found:
            figures = ", ".join(f"{name} {number:g}" for name, number in one.items() if name != "value")
            lines.append(f"| `{title}` | {one['value']:g} | {figures.replace('refused 1', 'refused')} |")
    return "\n".join(lines)


def main() -> None:
    """Of the constants named, or of all; the others' figures in the file stay."""
    begun = time.process_time()
    file = RESULTS / "constants.json"
    result: dict[str, list[dict[str, float]]] = json.loads(file.read_text()) if file.exists() else {}
    for title, (modules, name, values, figures) in cases().items():
        if sys.argv[1:] and title not in sys.argv[1:]:
            continue
        print(title)
        result[title] = []
        for value in values:
            with replaced(modules, name, value):
                found = {"value": float(value)} | _or_refused(figures)
            result[title].append({key: float(f"{number:.3g}") for key, number in found.items()})
            print("  ", result[title][-1])
        file.write_text(json.dumps(result, indent=1) + "\n")
    print(f"{time.process_time() - begun:.0f} s of processor time")


if __name__ == "__main__":
    main()
