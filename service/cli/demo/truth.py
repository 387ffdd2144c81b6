"""Errors of measured and identified inertias with respect to the virtual robot's true ones."""

import json
import subprocess
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from service.cli.demo.processes import command, environment
from service.identification.model.base_parameters import base_parameters
from service.identification.model.regressor import lock
from service.model.errors import SweepidError
from service.report import Content, ReportedAxis, TruthRow

Array = NDArray[np.float64]

_TIMEOUT = 120.0  # s


def read_truth(scenario: Path, poses: Array, scratch: Path) -> dict[str, Array]:
    """True inertia (m,) of every joint at poses (m, n), from the command `sweepid drive truth`."""
    scratch.write_text(json.dumps(poses.tolist()), encoding="utf-8")
    arguments = command("drive", "truth", str(scenario), "--poses", str(scratch))
    answer = subprocess.run(arguments, capture_output=True, text=True, env=environment(), timeout=_TIMEOUT, check=False)
    scratch.unlink()
    if answer.returncode:
        raise SweepidError(f"sweepid drive truth: {answer.stderr.strip()}")
    return {joint: np.array(values, dtype=float) for joint, values in json.loads(answer.stdout).items()}


def compare(content: Content, axes: Sequence[ReportedAxis], scenario: Path, scratch: Path) -> tuple[TruthRow, ...]:
    """Errors in percent, one column per axis: median and, in brackets, the 95th percentile of their absolute values.

    "sweeps": each measured inertia; "workspace": the resulting models, over all collision-free poses. The
    paper's formula (8) becomes a model by standard least squares, as in the paper.
    """
    workspace = read_truth(scenario, content.workspace, scratch)
    in_sweeps = {axis.joint: read_truth(scenario, axis.poses, scratch)[axis.joint] for axis in axes}
    from_paper = _paper_model(content, axes)
    lines = (
        ("paper's formula, sweeps", [(axis.paper, in_sweeps[axis.joint]) for axis in axes]),
        ("our estimate, sweeps", [(axis.measured, in_sweeps[axis.joint]) for axis in axes]),
        ("CAD model, workspace", [(axis.reference_workspace, workspace[axis.joint]) for axis in axes]),
        ("paper's formula, workspace", [(from_paper[a.joint], workspace[a.joint]) for a in axes]),
        ("our model, workspace", [(a.identified_workspace, workspace[a.joint]) for a in axes]),
    )
    return tuple(TruthRow(label, tuple(_error(found, true) for found, true in pairs)) for label, pairs in lines)


def _paper_model(content: Content, axes: Sequence[ReportedAxis]) -> dict[str, Array]:
    """Inertias over the workspace from base parameters fitted to the paper's values by standard least squares."""
    chain = content.robot.chain
    poses = np.array([spec.pose for spec in content.specs])
    moved = [content.robot.index(axis.joint) for axis in axes]
    free = [k for k in range(len(chain.joints)) if k in moved or np.ptp(poses[:, k]) > 0]
    chain = lock(chain, {k: float(poses[0, k]) for k in range(len(chain.joints)) if k not in free})
    own = [free.index(k) for k in moved]
    base = base_parameters(chain, tuple(sorted(own)))
    rows = np.vstack([base.rows(chain, k, axis.poses[:, free]) for k, axis in zip(own, axes, strict=True)])
    parameters = np.linalg.lstsq(rows, np.concatenate([axis.paper for axis in axes]), rcond=None)[0]
    return {
        axis.joint: base.rows(chain, k, content.workspace[:, free]) @ parameters
        for k, axis in zip(own, axes, strict=True)
    }


def _error(found: Array, true: Array) -> str:
    error = 100 * np.abs(found / true - 1)
    return f"{np.median(error):.2f} ({np.percentile(error, 95):.2f})"
