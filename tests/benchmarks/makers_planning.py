"""How fast 300 poses of robots with meshes are planned. Prints each figure and writes `results/makers_planning.json`.

    python -m tests.benchmarks.makers_planning [--poses 300]

The whole plan of three axes, two of them varied on the 5 deg grid (2.5 deg where that has too few poses): seconds by
the clock and of the processor; the latter a busy computer does not lengthen, and they may be `MOST_SECONDS`.
"""

import argparse
import json
import os
import time
from pathlib import Path
from typing import Any

from service.errors import BadInput
from service.planning.plan import PlanRequest, build_plan
from tests.makers_robots import MAKERS, Maker, completed

RESULT = Path(__file__).parent / "results" / "makers_planning.json"
MOST_SECONDS = 10.0
STEPS = (5.0, 2.5)  # deg


def figures(maker: Maker, poses: int) -> dict[str, Any]:
    robot, cell = completed(maker)
    refused = ""
    for step in STEPS:
        request = PlanRequest(robot_id=1, axes=maker.axes, varied=maker.varied, poses=poses, step=step)
        clock, processor = time.perf_counter(), time.process_time()
        try:
            plan = build_plan(robot, request, cell)
        except BadInput as error:
            refused = str(error)
            continue
        busy = time.process_time() - processor
        return {
            "axes": len(robot.joints),
            "meshes": robot.urdf_text.count("<hull"),
            "step: deg": step,
            "grid": plan.candidates,
            "measurable": plan.measurable,
            "sweeps": len(plan.sweeps),
            "s": round(time.perf_counter() - clock, 2),
            "processor s": round(busy, 2),
            "within": busy <= MOST_SECONDS,
        }
    return {"refused": refused}


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--poses", type=int, default=300)
    wanted = parser.parse_args()
    found: dict[str, Any] = {"poses": wanted.poses, "load before": os.getloadavg()[0]}
    for maker in MAKERS:
        found[maker.name] = figures(maker, wanted.poses)
        print(maker.name, found[maker.name], flush=True)
    RESULT.write_text(json.dumps(found, indent=2) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
