"""The content of a model revision: effects and rigid fit of each axis, and the scenario of the twin.

All data come from results of axes (`document.axis_document`), so a revision can be made wherever those are stored.
"""

from collections.abc import Mapping, Sequence
from typing import cast

import numpy as np

from service.diagnosis.effects.effect import Inexpressible, LinkEntry, Patch, merged
from service.diagnosis.model.scenario import (
    AxisEntry,
    Links,
    axis_entry,
    deviations,
    gravity,
    gravity_of_fit,
    inertia_factors,
    joined,
    stiffened,
)
from service.model import Array, Robot
from service.model.results.diagnosis import AxisDiagnosis, DiagnosedModel, Diagnosis
from service.model.results.effect import AxisFit, ModelRevision, RevisedAxis

Axes = Mapping[str, RevisedAxis]

ROBOT_FILE = "robot.yaml"


def model_document(
    robot: Robot,
    diagnosis: Diagnosis,
    joints: Sequence[str] | None = None,
    parent: ModelRevision | None = None,
) -> ModelRevision:
    """Effects and fit of `joints` of a diagnosis (None: those named), and the scenario. The other axes are copied from
    `parent`, the previous model.
    """
    named = [joint for joint, axis in diagnosis.axes.items() if axis.verdict == "named"]
    axes = dict(parent.axes) if parent else {}
    axes |= {joint: _axis(diagnosis.axes[joint]) for joint in (named if joints is None else joints)}
    scenario, notes = _scenario(robot, axes)
    return ModelRevision.model_validate({"axes": axes, "scenario": scenario, "notes": notes})


def model_of(robot: Robot, diagnoses: Mapping[str, AxisDiagnosis]) -> DiagnosedModel:
    """The model of a diagnosis: known and newly named effects of its axes, and the scenario of all axes."""
    axes = {joint: _axis(axis) for joint, axis in diagnoses.items()}
    effects = {joint: axis.effects for joint, axis in axes.items() if diagnoses[joint].verdict == "named"}
    scenario, notes = _scenario(robot, axes)
    given = {"robot": robot.name, "effects": effects, "scenario": scenario, "notes": notes}
    return DiagnosedModel.model_validate(given)


def _axis(axis: AxisDiagnosis) -> RevisedAxis:
    """Effects and fit of an axis; ambiguous effects are not in its model."""
    return RevisedAxis(effects=axis.known + axis.effects * (axis.verdict == "named"), fit=axis.fit)


def _scenario(robot: Robot, axes: Axes) -> tuple[Mapping[str, object], tuple[str, ...]]:
    """The scenario, and notes about parts of the model that it cannot contain."""
    notes: list[str] = []
    entries: dict[str, AxisEntry] = {}
    for joint, axis in axes.items():
        try:
            entries[joint] = _entry(robot, joint, axis)
        except Inexpressible as reason:
            notes.append(f"{joint}: {reason}; the axis is rigid here")
            entries[joint] = _entry(robot, joint, axis.model_copy(update={"effects": ()}))
        notes += [f"{joint}: {held}" for held in entries[joint].held]
        notes += [f"{joint}: no scenario holds {e.effect}" for e in axis.effects if e.scenario is None]
    if any("spring" in entry.train for entry in entries.values()):
        entries = {
            joint: stiffened(entry, _inertia(axes[joint]), robot.axis(joint).gear_ratio)
            for joint, entry in entries.items()
        }
    measurement: dict[str, float] = {}
    for name in ("effort_delay", "velocity_delay"):
        delays = [entry.measurement[name] for entry in entries.values() if name in entry.measurement]
        if delays:
            measurement[name] = float(np.mean(delays))
        if len(delays) > 1:
            notes.append(f"{name} is the mean of {', '.join(f'{delay:.3g} s' for delay in delays)}")
    # Hz, bandwidth of an assumed speed control, which a diagnosis cannot identify
    # 0.1 s
    # 3.0 times the rated effort
    scenario: dict[str, object] = {
        "name": f"{robot.name}-model",
        "robot": ROBOT_FILE,
        "links": _links(robot, axes, entries, notes),
        "axes": {
            joint: {
                "train": entry.train,
                "control": {
                    "gain": 2 * np.pi * 8.0 * _inertia(axes[joint]),
                    "reset_time": 0.1,
                    "effort_limit": 3.0 * robot.axis(joint).rated_effort,
                },
                "load_encoder": False,
            }
            for joint, entry in entries.items()
        },
        "measurement": measurement,
    }
    return scenario, tuple(notes)


def _entry(robot: Robot, joint: str, axis: RevisedAxis) -> AxisEntry:
    patches = [cast(Patch, effect.scenario) for effect in axis.effects if effect.scenario is not None]
    true = axis.fit.torques == "true"
    return axis_entry(robot, joint, _inertia(axis), axis.fit.viscous_friction.value, patches, true=true)


def _pull(robot: Robot, fit: AxisFit, links: Links, index: int, poses: Array, scale: float) -> Array:
    """True gravity (m, 2) as fitted; older documents do not contain "gravity", there it is computed from the links."""
    if fit.gravity is None:
        return gravity(robot, links, index, poses)
    torque, slope = np.array([(pose.torque, pose.slope) for pose in fit.gravity]).T
    return gravity_of_fit(poses, index, torque, slope) / scale


def _inertia(axis: RevisedAxis) -> float:
    """Typical inertia, kg m^2."""
    return float(np.mean([pose.value for pose in axis.fit.inertia]))


def _links(robot: Robot, axes: Axes, entries: Mapping[str, AxisEntry], notes: list[str]) -> Links:
    """Links that give each axis its gravity and, as far as rigid links can, its inertias; those of CAD where there are
    none, with a note.
    """
    gravities: list[tuple[int, Array, Array]] = []
    inertias: list[tuple[int, Array, Array]] = []
    added: dict[str, LinkEntry] = {}
    for joint, entry in entries.items():
        index, fit = robot.index(joint), axes[joint].fit
        poses = np.array([pose.pose for pose in fit.inertia])
        shifted = {link: part.copy() for link, part in entry.links.items()}
        for part in shifted.values():
            part.pop("added", None)
        pull = _pull(robot, fit, shifted, index, poses, entry.scale) - gravity(robot, {}, index, poses)
        gravities.append((index, poses, pull))
        measured = np.array([pose.value for pose in fit.inertia]) / entry.scale
        motor = entry.train["motor_inertia"] * robot.axis(joint).gear_ratio ** 2
        inertias.append((index, poses, np.maximum(measured - motor, 0.02 * measured)))
        # a payload is one body, on whichever axis it was found
        added = {link: LinkEntry(added=part["added"]) for link, part in entry.links.items() if "added" in part} | added
    moved: Links = {}
    factors: dict[str, float] = {}
    try:
        moved = deviations(robot, joined(robot, gravities))
    except Inexpressible as reason:
        notes.append(f"{reason}; masses and centres of the links are those of CAD here")
    links = merged(moved, added)
    try:
        factors = inertia_factors(robot, links, inertias)
    except Inexpressible as reason:
        notes.append(f"{reason}; inertias of the links are those of CAD here")
    return merged(links, {link: {"inertia": factor} for link, factor in factors.items() if factor != 1.0})
