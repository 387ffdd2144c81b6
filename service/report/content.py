"""The content of a report: plain data from the store, a bundle or the API, and the models computed from it.

The identified model consists of the estimate's `standard_parameters`, which reproduce its base parameters. Therefore
the estimate document of `sweepid identify --json` contains all that is needed.
"""

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np

from drivers.ports import AxisIdentity
from service.identification.model import SAME_POSITION, axis_rows, lock
from service.model import INERTIAL_NAMES, Array, Robot, Sweep, SweepSpec
from service.model.collision import reachable
from service.model.results.diagnosis import DataCheck, Diagnosis
from service.model.results.estimate import BaseParameter, Estimate
from service.report.drawing import slides


@dataclass(frozen=True, slots=True)
class Revision:
    """The base parameters after `sweeps` sweeps, (r,) each; NaN where a revision does not have them."""

    sweeps: int
    values: Array
    std: Array


@dataclass(frozen=True, slots=True)
class TruthRow:
    """One row of a table of values known only to the caller, for example errors with respect to a virtual robot."""

    label: str
    figures: tuple[str, ...]


@dataclass(frozen=True)
class Content:
    """The complete content of a report. `workspace` (m, n): the poses over which models are drawn."""

    title: str
    subtitle: str
    robot: Robot
    estimate: Estimate
    specs: tuple[SweepSpec, ...]
    workspace: Array
    revisions: tuple[Revision, ...] = ()
    example: Sweep | None = None  # shown in time and frequency
    truth_columns: tuple[str, ...] = ()
    truth: tuple[TruthRow, ...] = ()


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
class ReportedAxis:
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


def axes_of(content: Content) -> tuple[ReportedAxis, ...]:
    """The measured axes in the order of the estimate."""
    model = _Models(content)
    order = {spec.id: number for number, spec in enumerate(content.specs, start=1)}
    poses = {spec.id: spec.pose for spec in content.specs}
    axes: list[ReportedAxis] = []
    for joint, found in content.estimate.axes.items():
        sweeps, rmse = sorted(found.inertia, key=lambda sweep: order[sweep.sweep]), found.rmse_percent
        own = np.array([poses[sweep.sweep] for sweep in sweeps])
        index = content.robot.index(joint)
        identified, reference = model.inertia(index, own)
        identified_workspace, reference_workspace = model.inertia(index, content.workspace)
        axes.append(
            ReportedAxis(
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
                rmse=(rmse.reference_measured, rmse.identified_measured, rmse.reference_identified),
            )
        )
    return tuple(axes)


def revision(parameters: Sequence[BaseParameter], names: Sequence[str], sweeps: int) -> Revision:
    """The revision as one step of the convergence of the parameters `names` (those of the last estimate)."""
    found = {entry.name: (entry.value, _number(entry.std)) for entry in parameters}
    values = np.array([found.get(name, (math.nan, math.nan)) for name in names]).reshape(-1, 2)
    return Revision(sweeps, values[:, 0], values[:, 1])


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


def content_of(
    robot: Robot,
    estimate: Estimate,
    specs: Iterable[SweepSpec],
    read: Callable[[SweepSpec], Sweep],
    subtitle: str,
    *,
    revisions: Iterable[tuple[int, Sequence[BaseParameter]]] = (),
) -> Content:
    """The content of a report of an estimate that has the inertia of an axis.

    `specs`: at least of the sweeps that the estimate used. `read` returns the samples of one of them, for the example.
    `revisions`: number of sweeps and base parameters of the earlier estimates.
    """
    used = used_sweeps(estimate, specs)
    names = [entry.name for entry in estimate.base_parameters]
    return Content(
        title=f"Inertias of the robot {robot.name}",
        subtitle=subtitle,
        robot=robot,
        estimate=estimate,
        specs=used,
        workspace=covered(robot, used),
        revisions=tuple(revision(parameters, names, number) for number, parameters in revisions),
        example=read(example_of(used)),
    )


def used_sweeps(estimate: Estimate, specs: Iterable[SweepSpec]) -> tuple[SweepSpec, ...]:
    """The sweeps whose inertia is in the estimate, in their order."""
    used = {one.sweep for axis in estimate.axes.values() for one in axis.inertia}
    return tuple(spec for spec in specs if spec.id in used)


def example_of(used: Sequence[SweepSpec]) -> SweepSpec:
    """The sweep with the most lines, of the first measured axis."""
    return max((spec for spec in used if spec.axis == used[0].axis), key=lambda spec: len(spec.sines))


def covered(robot: Robot, used: Sequence[SweepSpec]) -> Array:
    """Poses (m, n) without self-collision, on a grid over the range of the joints that varied.

    A bundle does not know the cell, so no report uses it: all of one robot show the same poses. Nothing is drawn
    outside the measured range. If no joint varied: the poses of the sweeps.
    """
    stood = np.unique([spec.pose for spec in used], axis=0)
    varied = np.flatnonzero(np.ptp(stood, axis=0) > SAME_POSITION)
    if not varied.size:
        return stood
    # largest number of positions of one joint
    count = max(2, min(25, math.floor(2000 ** (1 / varied.size))))  # poses for the drawing of models, at most
    ranges = [np.linspace(float(stood[:, k].min()), float(stood[:, k].max()), count).tolist() for k in varied]
    poses = np.tile(stood.mean(axis=0), (count**varied.size, 1))
    poses[:, varied] = list(product(*ranges))
    return reachable(robot, stood, poses)
