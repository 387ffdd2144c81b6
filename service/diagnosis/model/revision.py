"""The content of a model revision: effects and rigid fit of each axis, and the scenario of the twin.

All data come from axis documents (`document.axis_document`), so a revision can be made wherever those are stored.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from service.diagnosis.effects.effect import Inexpressible, merged
from service.diagnosis.model.scenario import (
    AxisEntry,
    axis_entry,
    deviations,
    gravity,
    gravity_of_fit,
    inertia_factors,
    joined,
    stiffened,
)
from service.model.robot import Robot

Documents = Mapping[str, Mapping[str, Any]]

ROBOT_FILE = "robot.yaml"


def model_document(
    robot: Robot,
    document: Mapping[str, Any],
    joints: Sequence[str] | None = None,
    parent: Mapping[str, Any] | None = None,
) -> dict[str, Any]:
    """{"axes": {joint: {"effects", "fit"}}, "scenario"} of a diagnosis document for `joints` (None: those named). The
    other axes are copied from `parent`, the previous model.
    """
    named = [joint for joint, axis in document["axes"].items() if axis["verdict"] == "named"]
    axes = dict(parent["axes"]) if parent else {}
    axes |= {joint: _axis(document["axes"][joint]) for joint in (named if joints is None else joints)}
    return {"axes": axes, **_scenario(robot, axes)}


def model_of(robot: Robot, documents: Documents) -> dict[str, Any]:
    """The "model" of a diagnosis: known and newly named effects of its axes, and the scenario of all axes."""
    axes = {joint: _axis(axis) for joint, axis in documents.items()}
    effects = {joint: axis["effects"] for joint, axis in axes.items() if documents[joint]["verdict"] == "named"}
    return {"robot": robot.name, "effects": effects, **_scenario(robot, axes)}


def _axis(document: Mapping[str, Any]) -> dict[str, Any]:
    """Effects and fit of an axis; ambiguous effects are not in its model."""
    effects = list(document["known"])
    if document["verdict"] == "named":
        effects += document["effects"]
    return {"effects": effects, "fit": document["fit"]}


def _scenario(robot: Robot, axes: Documents) -> dict[str, Any]:
    """The scenario, and notes about parts of the model that it cannot contain."""
    notes: list[str] = []
    entries: dict[str, AxisEntry] = {}
    for joint, axis in axes.items():
        try:
            entries[joint] = _entry(robot, joint, axis)
        except Inexpressible as reason:
            notes.append(f"{joint}: {reason}; the axis is rigid here")
            entries[joint] = _entry(robot, joint, {**axis, "effects": []})
        notes += [f"{joint}: {held}" for held in entries[joint].held]
        notes += [f"{joint}: no scenario holds {e['effect']}" for e in axis["effects"] if e["scenario"] is None]
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
    scenario = {
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
    return {"scenario": scenario, "notes": notes}


def _entry(robot: Robot, joint: str, axis: Mapping[str, Any]) -> AxisEntry:
    patches = [effect["scenario"] for effect in axis["effects"] if effect["scenario"] is not None]
    viscous, true = axis["fit"]["viscous_friction"]["value"], axis["fit"]["torques"] == "true"
    return axis_entry(robot, joint, _inertia(axis), viscous, patches, true=true)


def _pull(robot: Robot, fit: Mapping[str, Any], links: Mapping[str, Any], index: int, poses: Any, scale: float) -> Any:
    """True gravity (m, 2) as fitted; older documents do not contain "gravity", there it is computed from the links."""
    if "gravity" not in fit:
        return gravity(robot, links, index, poses)
    torque, slope = (np.array([pose[part] for pose in fit["gravity"]]) for part in ("torque", "slope"))
    return gravity_of_fit(poses, index, torque, slope) / scale


def _inertia(axis: Mapping[str, Any]) -> float:
    """Typical inertia, kg m^2."""
    return float(np.mean([pose["value"] for pose in axis["fit"]["inertia"]]))


def _links(robot: Robot, axes: Documents, entries: Mapping[str, AxisEntry], notes: list[str]) -> dict[str, Any]:
    """Links that give each axis its gravity and, as far as rigid links can, its inertias; those of CAD where there are
    none, with a note.
    """
    gravities: list[tuple[int, Any, Any]] = []
    inertias: list[tuple[int, Any, Any]] = []
    added: dict[str, Any] = {}
    for joint, entry in entries.items():
        index, poses = robot.index(joint), np.array([pose["pose"] for pose in axes[joint]["fit"]["inertia"]])
        shifted = {link: {key: x for key, x in part.items() if key != "added"} for link, part in entry.links.items()}
        gravities.append(
            (
                index,
                poses,
                _pull(robot, axes[joint]["fit"], shifted, index, poses, entry.scale) - gravity(robot, {}, index, poses),
            )
        )
        measured = np.array([pose["value"] for pose in axes[joint]["fit"]["inertia"]]) / entry.scale
        motor = entry.train["motor_inertia"] * robot.axis(joint).gear_ratio ** 2
        inertias.append((index, poses, np.maximum(measured - motor, 0.02 * measured)))
        # a payload is one body, on whichever axis it was found
        added = {link: {"added": part["added"]} for link, part in entry.links.items() if "added" in part} | added
    moved: dict[str, Any] = {}
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
