"""A diagnosis as the JSON object that `sweepid diagnose --json` prints."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

from service.diagnosis.effects import CATALOGUE
from service.diagnosis.fit.fitted import Parameter
from service.diagnosis.model.revision import model_of
from service.diagnosis.summary import summary
from service.model.results.diagnosis import AxisDiagnosis, standing_of
from service.model.robot import Robot

if TYPE_CHECKING:  # the service composes documents of axes that its worker has diagnosed
    from service.diagnosis.diagnose import AxisResult, NamedEffect
    from service.diagnosis.experiments import NextExperiment


def as_document(robot: Robot, diagnoses: "Sequence[AxisResult]") -> dict[str, Any]:
    """The document of all axes, with the model that results from the named effects."""
    return compose(robot, {one.joint: axis_document(one) for one in diagnoses})


def compose(robot: Robot, axes: Mapping[str, Mapping[str, Any]]) -> dict[str, Any]:
    """The document of all axes, composed from the documents of single axes."""
    return {"axes": dict(axes), "model": model_of(robot, axes)}


def axis_document(one: "AxisResult") -> dict[str, Any]:
    """One axis; torques in N m (forces in N), see docs/reference/cli.md."""
    gap, effort = one.gap, one.gap.effort_rms
    document: dict[str, Any] = {
        "verdict": one.verdict.value,
        "unit": one.unit,
        "effects": [_effect(effect, one.unit) for effect in one.effects],
        "known": [_effect(effect, one.unit) for effect in one.known],
        "part": [_effect(effect, one.unit) for effect in one.part],
        "changes": [
            {
                "effect": c.effect,
                "parameter": c.parameter,
                "model": _value(c.model, one.unit),
                "now": _value(c.now, one.unit),
            }
            for c in one.changes
        ],
        "candidates": list(one.candidates),
        "alternatives": [list(names) for names in one.alternatives],
        "rivals": [{"effect": effect, "behind": behind} for effect, behind in one.rivals],
        "rolled_back": list(one.rolled_back),
        "where": [asdict(cell) | {"value": _in_units(cell.value, one.unit)} for cell in one.cells],
        "sentences": [_in_units(sentence, one.unit) for sentence in one.sentences],
        "gap": {
            "before_rms": gap.before_rms,
            "after_rms": gap.after_rms,
            "noise_floor_rms": gap.noise_floor_rms,
            "held_out_sweeps": gap.held_out_sweeps,
            "cross_validated": gap.others,
            "source": "columns",  # residuals of the model columns: `before_rms` and `after_rms`
            "before_percent": 100 * gap.before_rms / effort,
            "after_percent": 100 * gap.after_rms / effort,
            "twin_rms": one.twin_rms,
            "by_pose": [asdict(pose) | {"pose": list(pose.pose)} for pose in gap.by_pose],
        },
        "example": {
            "sweep": one.example.sweep,
            "block": one.example.block,
            **{name: getattr(one.example, name).tolist() for name in ("time", "measured", "before", "after")},
        },
        "fit": {
            "inertia": [
                {"pose": list(pose), "value": value, "std": std}
                for pose, value, std in zip(
                    one.poses, one.fit.inertia.tolist(), one.fit.inertia_std.tolist(), strict=True
                )
            ],
            "gravity": [
                {"pose": list(pose), "torque": torque, "slope": slope}
                for pose, torque, slope in zip(one.poses, *one.fit.load[1:].tolist(), strict=True)
            ],
            "viscous_friction": {"value": one.fit.viscous, "std": one.fit.viscous_std},
            "torques": "true" if one.weighed else "recorded",
        },
        "started_from": one.started_from,
        "rigid_model": [asdict(parameter) for parameter in one.rigid_model],
        "unexplained": one.unexplained,
        "next_experiment": None if one.next_experiment is None else _experiment(one.next_experiment),
        "untestable": list(one.untestable),
        "biasing": list(one.biasing),
        "data": [asdict(finding) for finding in one.data],
        "visible_in": {effect: list(CATALOGUE[effect].visible_in) for effect in one.untestable},
    }
    if one.unfinished:
        document["unfinished"] = [asdict(search) for search in one.unfinished]
    document["summary"] = summary(one.joint, document)
    return document | {"standing": standing_of(AxisDiagnosis.model_validate(document))}


def _in_units(text: str, effort: str) -> str:
    """Correct the units for a prismatic axis (effort in N, no radians); the effects use revolute units for all axes."""
    return text if effort != "N" else re.sub(r"\brad(2?)\b", r"m\1", re.sub(r"\bN m\b", "N", text))


def _effect(effect: "NamedEffect", unit: str) -> dict[str, Any]:
    entry = CATALOGUE[effect.name]
    return {
        "effect": effect.name,
        "sentence": entry.sentence,
        "physics": entry.physics,
        "source": entry.source,
        "parameters": {name: _value(parameter, unit) for name, parameter in effect.parameters.items()},
        "covariance": effect.covariance.tolist(),
        "evidence": {"chi_squared_gain": effect.gain, "criterion_gain": effect.criterion_gain},
        "scenario_entry": entry.entry,
        "scenario": effect.patch,
    }


def _value(parameter: Parameter, unit: str) -> dict[str, Any]:
    return {"value": parameter.value, "std": parameter.std, "unit": _in_units(parameter.unit, unit)}


def _experiment(experiment: "NextExperiment") -> dict[str, Any]:
    return {
        "kind": experiment.kind,
        "blocks": list(experiment.blocks),
        "sweeps": [
            {"spec": sweep.spec.model_dump(mode="json"), "ramp": sweep.ramp, "settle": sweep.settle}
            for sweep in experiment.sweeps
        ],
        "seconds": experiment.seconds,
        "separation": experiment.separation,
        "between": list(experiment.between),
        "reason": experiment.reason,
    }
