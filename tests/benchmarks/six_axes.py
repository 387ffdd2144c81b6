"""Six axes: base parameters of sweeps, of trajectories and of both; torque prediction; J of every axis against truth.

    python -m tests.benchmarks.six_axes [--poses 60] [--trajectories 4] [--period 10] [--seed 0]

Prints each figure and writes tests/benchmarks/results/six_axes.json. One trajectory more is designed and held out.
"""

import argparse
import json
from pathlib import Path
from typing import Any

import numpy as np

from service.identification import identify
from service.identification.design.exciting_trajectory import Shape
from service.identification.estimates.combination import Combination, combine, inertias_of
from service.identification.estimates.estimate import Estimate
from service.identification.model.base_parameters import base_parameters
from service.identification.model.whole_base import dynamic_base
from service.robot import Robot
from simulator import Scenario, load_scenario, true_inertia
from tests.numeric.campaign import CONFIG, max100
from tests.numeric.six_axes import (
    design,
    deviation,
    free_poses,
    measure_sweeps,
    measure_trajectories,
    prediction,
    records,
)

RESULT = Path(__file__).parent / "results" / "six_axes.json"
GRID = 400  # free random poses over which J is compared with the truth


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--poses", type=int, default=60)
    parser.add_argument("--trajectories", type=int, default=4)
    parser.add_argument("--period", type=float, default=10.0)
    parser.add_argument("--restarts", type=int, default=40)
    parser.add_argument("--steps", type=int, default=200)
    parser.add_argument("--seed", type=int, default=0)
    asked = parser.parse_args()
    robot, scenario = max100(), load_scenario(CONFIG / "scenarios" / "max100-six.yaml")
    rng = np.random.default_rng(asked.seed)

    _, spectra = measure_sweeps(robot, scenario, free_poses(robot, rng, asked.poses), asked.seed)
    estimate = identify(robot, spectra)
    shape = Shape(period=asked.period)
    trajectories = [
        design(robot, shape, asked.seed + number, asked.restarts, asked.steps)
        for number in range(asked.trajectories + 1)
    ]
    measured = measure_trajectories(robot, scenario, trajectories, asked.seed)
    both = combine(robot, inertias_of(estimate), records(robot, measured[:-1]))
    (held_out,) = records(robot, measured[-1:])

    result = {
        **vars(asked),
        "base_parameters": {
            "sweeps": len(base_parameters(robot.chain, tuple(range(len(robot.axes)))).columns),
            "trajectories": len(dynamic_base(robot).columns),
            "combination": len(both.parameters),
        },
        "condition": [trajectory.condition for trajectory in trajectories],
        "parameters": parameters(both),
        "z": deviation(both, scenario).tolist(),
        "prediction_percent": prediction(both, held_out, measured[-1]),
        "inertia": inertia(robot, scenario, estimate, both, rng),
        "noise": {joint: [both.noise[joint], both.scatter[joint]] for joint in both.noise},
    }
    RESULT.write_text(json.dumps(result, indent=1) + "\n")
    show(result)


def parameters(both: Combination) -> list[dict[str, Any]]:
    return [
        {
            "name": p.name,
            "value": p.value,
            "std": p.std,
            "std_sweeps": finite(p.std_sweeps),
            "std_trajectories": finite(p.std_trajectories),
            "std_prior": p.std_prior,
            "source": p.source.value,
            "identified": p.identified,
            "by_combination": p.by_combination,
            "reason": p.reason,
        }
        for p in both.parameters
    ]


def inertia(
    robot: Robot, scenario: Scenario, estimate: Estimate, both: Combination, rng: np.random.Generator
) -> dict[str, dict[str, float]]:
    """Identified against true J in percent: in the poses measured, over free poses by sweeps and by both."""
    grid = free_poses(robot, rng, GRID)
    result: dict[str, dict[str, float]] = {}
    for axis in inertias_of(estimate):
        true = true_inertia(scenario, axis.joint, grid)
        own = true_inertia(scenario, axis.joint, axis.poses)
        std = np.sqrt(np.diag(axis.covariance))
        by_sweeps = 100 * (estimate.identified(axis.joint, grid) / true - 1)
        by_both = 100 * (both.inertia(axis.joint, grid) / true - 1)
        result[axis.joint] = {
            "single_rmse": float(np.sqrt(np.mean((100 * (axis.values / own - 1)) ** 2))),
            "single_chi_squared": float(np.mean(((axis.values - own) / std) ** 2)),
            "sweeps_rmse": float(np.sqrt(np.mean(by_sweeps**2))),
            "sweeps_worst": float(np.abs(by_sweeps).max()),
            "both_rmse": float(np.sqrt(np.mean(by_both**2))),
            "both_worst": float(np.abs(by_both).max()),
        }
    return result


def show(result: dict[str, Any]) -> None:
    counts = result["base_parameters"]
    print("base parameters:", ", ".join(f"{source} {count}" for source, count in counts.items()))
    print("condition numbers of the trajectories:", ", ".join(f"{value:.0f}" for value in result["condition"]))
    identified = [p for p in result["parameters"] if p["identified"]]
    print(f"identified: {len(identified)} of {len(result['parameters'])}")
    print(
        f"against truth: RMS of z {np.sqrt(np.mean(np.square(result['z']))):.2f}, worst {np.abs(result['z']).max():.1f}"
    )
    for p, z in zip(result["parameters"], result["z"], strict=True):
        stds = " ".join(f"{p[key] or np.inf:9.3g}" for key in ("std", "std_sweeps", "std_trajectories", "std_prior"))
        note = p["reason"] or p["source"] + (" (became identifiable)" if p["by_combination"] else "")
        print(f"  {p['value']:10.4g} {z:5.1f} {stds}  {note:38} {p['name'][:60]}")
    print("prediction of the held-out trajectory, % of rated effort: every sample, below 10 Hz")
    for joint, (whole, low) in result["prediction_percent"].items():
        print(f"  {joint} {whole:6.2f} {low:6.2f}")
    print("J against truth, %: single sweeps RMSE (chi-squared), free poses RMSE / worst by sweeps, by both")
    for joint, row in result["inertia"].items():
        print(
            f"  {joint} {row['single_rmse']:6.2f} ({row['single_chi_squared']:.2f})"
            f"   {row['sweeps_rmse']:6.2f} / {row['sweeps_worst']:.2f}"
            f"   {row['both_rmse']:6.2f} / {row['both_worst']:.2f}"
        )


def finite(value: float) -> float | None:
    return value if np.isfinite(value) else None


if __name__ == "__main__":
    main()
