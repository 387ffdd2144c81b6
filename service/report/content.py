"""The content of a report: plain data from the store, a bundle or the API, and the models computed from it.

The identified model consists of the estimate's `standard_parameters`, which reproduce its base parameters. Therefore
the estimate document of `sweepid identify --json` contains all that is needed.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from drivers.ports import AxisIdentity
from service.identification.model.regressor import axis_rows, lock
from service.model.recording import Sweep, SweepSpec
from service.model.results.diagnosis import DataCheck, Diagnosis
from service.model.results.estimate import BaseParameter, Estimate
from service.model.robot import INERTIAL_NAMES, Robot
from service.report.drawing import slides

Array = NDArray[np.float64]

SAME_POSITION = 2e-3  # rad (m): joints that differ by less between poses are constant


@dataclass(frozen=True, slots=True)
class Revision:
    """The base parameters after `sweeps` sweeps, (r,) each; NaN where a revision does not have them."""

    sweeps: int
    values: Array
    std: Array


@dataclass(frozen=True, slots=True)
class Row:
    """One row of a table of values known only to the caller, for example errors with respect to a virtual robot."""

    label: str
    figures: tuple[str, ...]


@dataclass(frozen=True)
class Content:
    """The complete content of a report. `workspace` (m, n): the collision-free poses over which models are drawn."""

    title: str
    subtitle: str
    robot: Robot
    estimate: Estimate
    specs: tuple[SweepSpec, ...]
    workspace: Array
    revisions: tuple[Revision, ...] = ()
    example: Sweep | None = None  # shown in time and frequency
    truth_columns: tuple[str, ...] = ()
    truth: tuple[Row, ...] = ()
    diagnosis: Diagnosis | None = None


@dataclass(frozen=True, slots=True)
class Drive(AxisIdentity):
    """Identity data that a drive reported while `sweeps` sweeps were recorded (CiA 301 object 1018h)."""

    sweeps: int


@dataclass(frozen=True, slots=True)
class CampaignReport:
    """Content of a campaign's report in addition to the estimate. `origin`: names and values, in order.

    `diagnosis`: number and content of the newest one. `test_mass`: kg.
    """

    title: str
    subtitle: str
    origin: tuple[tuple[str, str], ...]
    drives: tuple[Drive, ...]
    check: DataCheck | None
    diagnosis: tuple[int, Diagnosis] | None
    test_mass: float | None = None


@dataclass(frozen=True)
class Axis:
    """One axis: its sweeps in order of measurement, and both models. Inertias in kg m^2 (kg)."""

    joint: str
    unit: str  # of its inertia: kg m², of a linear axis kg
    poses: Array  # (k, n)
    numbers: tuple[int, ...]  # of the sweeps, 1, 2, ... in the order of measurement
    measured: Array  # (k,)
    std: Array  # (k,)
    paper: Array  # (k,), NaN where the paper's formula does not apply
    identified: Array  # (k,) of the identified model in these poses
    reference: Array  # (k,) of the nominal model
    workspace: Array  # (m, n)
    identified_workspace: Array  # (m,)
    reference_workspace: Array  # (m,)
    varied: tuple[int, ...]  # joints that vary between poses and affect this axis: those after it
    rmse: tuple[float, float, float]  # reference-measured, identified-measured, reference-identified; percent, Table 1


def axes_of(content: Content) -> tuple[Axis, ...]:
    """The measured axes in the order of the estimate."""
    model = _Models(content)
    order = {spec.id: number for number, spec in enumerate(content.specs, start=1)}
    poses = {spec.id: spec.pose for spec in content.specs}
    axes: list[Axis] = []
    for joint, found in content.estimate.axes.items():
        sweeps = sorted(found.inertia, key=lambda sweep: order[sweep.sweep])
        own = np.array([poses[sweep.sweep] for sweep in sweeps])
        index = content.robot.index(joint)
        identified, reference = model.inertia(index, own)
        identified_workspace, reference_workspace = model.inertia(index, content.workspace)
        axes.append(
            Axis(
                joint=joint,
                unit="kg" if slides(content.robot, index) else "kg m²",
                poses=own,
                numbers=tuple(order[sweep.sweep] for sweep in sweeps),
                measured=np.array([sweep.value for sweep in sweeps], dtype=float),
                std=np.array([sweep.std for sweep in sweeps], dtype=float),
                paper=np.array([_number(sweep.paper_value) for sweep in sweeps]),
                identified=identified,
                reference=reference,
                workspace=content.workspace,
                identified_workspace=identified_workspace,
                reference_workspace=reference_workspace,
                varied=tuple(int(k) for k in np.flatnonzero(np.ptp(own, axis=0) > SAME_POSITION) if k > index),
                rmse=(
                    found.rmse_percent.reference_measured,
                    found.rmse_percent.identified_measured,
                    found.rmse_percent.reference_identified,
                ),
            )
        )
    return tuple(axes)


def revision(parameters: Sequence[BaseParameter], names: Sequence[str], sweeps: int) -> Revision:
    """The revision as one step of the convergence of the parameters `names` (those of the last estimate)."""
    value = {entry.name: entry.value for entry in parameters}
    std = {entry.name: entry.std for entry in parameters}
    return Revision(
        sweeps,
        np.array([_number(value.get(name)) for name in names]),
        np.array([_number(std.get(name)) for name in names]),
    )


class _Models:
    """Identified and nominal parameters for the chain of the estimate, without its locked joints."""

    def __init__(self, content: Content) -> None:
        chain = content.robot.chain
        standard = content.estimate.standard_parameters
        poses = np.array([spec.pose for spec in content.specs])
        self._unlocked = [k for k, joint in enumerate(chain.joints) if joint.link in standard.links]
        fixed = {k: float(poses[:, k].mean()) for k in range(len(chain.joints)) if k not in self._unlocked}
        self._chain = lock(chain, fixed)
        links = [standard.links[joint.link][name] for joint in self._chain.joints for name in INERTIAL_NAMES]
        motors = list(standard.motor_inertias.values())
        self._identified = np.array([*links, *motors], dtype=float)
        nominal = [content.robot.axes[k].reflected_motor_inertia or 0.0 for k in self._unlocked]
        self._nominal = np.concatenate([self._chain.inertial.ravel(), nominal])

    def inertia(self, index: int, poses: Array) -> tuple[Array, Array]:
        """Identified and nominal inertia (m,) about joint number `index` at poses (m, n)."""
        rows = axis_rows(self._chain, self._unlocked.index(index), poses[:, self._unlocked])
        return rows @ self._identified, rows @ self._nominal


def _number(value: float | None) -> float:
    return float("nan") if value is None else float(value)
