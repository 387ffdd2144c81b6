"""A diagnosis as the JSON object that `sweepid diagnose --json` prints (DESIGN.md, "Data contracts")."""

from collections.abc import Sequence
from typing import Any

from service.diagnosis.diagnose import AxisDiagnosis, NamedEffect
from service.diagnosis.effects import CATALOGUE
from service.diagnosis.experiments import NextExperiment
from service.robot import Robot


def as_document(robot: Robot, diagnoses: Sequence[AxisDiagnosis]) -> dict[str, Any]:
    """All axes, and the model that the named effects make."""
    return {
        "axes": {one.joint: axis_document(one) for one in diagnoses},
        "model": {
            "robot": robot.name,
            "effects": {
                one.joint: [
                    _effect(effect) | {"scenario_entry": CATALOGUE[effect.name].entry} for effect in one.effects
                ]
                for one in diagnoses
                if one.verdict.value == "named"
            },
        },
    }


def axis_document(one: AxisDiagnosis) -> dict[str, Any]:
    """One axis."""
    return {
        "verdict": one.verdict.value,
        "effects": [_effect(effect) for effect in one.effects],
        "candidates": list(one.candidates),
        "where": [
            {
                "dimension": cell.dimension,
                "value": cell.value,
                "rms": cell.rms,
                "significance": cell.significance,
            }
            for cell in one.cells
        ],
        "sentences": list(one.sentences),
        "gap": {
            "before_rms": one.gap.before_rms,
            "after_rms": one.gap.after_rms,
            "noise_floor_rms": one.gap.noise_floor_rms,
            "held_out_sweeps": one.gap.held_out_sweeps,
            "before_percent": 100 * one.gap.before_rms / one.gap.effort_rms,
            "after_percent": 100 * one.gap.after_rms / one.gap.effort_rms,
        },
        "unexplained": one.unexplained,
        "next_experiment": None if one.next_experiment is None else _experiment(one.next_experiment),
        "untestable": list(one.untestable),
    }


def _effect(effect: NamedEffect) -> dict[str, Any]:
    return {
        "effect": effect.name,
        "sentence": effect.sentence,
        "parameters": {
            name: {"value": parameter.value, "std": parameter.std, "unit": parameter.unit}
            for name, parameter in effect.parameters.items()
        },
        "evidence": {"chi_squared_gain": effect.gain, "criterion_gain": effect.criterion_gain},
    }


def _experiment(experiment: NextExperiment) -> dict[str, Any]:
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
