"""A diagnosis as the results that `sweepid diagnose --json` prints."""

import re
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, cast

from service.diagnosis.effects import CATALOGUE
from service.diagnosis.fit.fitted import Parameter
from service.diagnosis.model.revision import model_of
from service.diagnosis.summary import summary
from service.model import Robot, SweepSpec
from service.model.results.diagnosis import (
    AxisDiagnosis,
    Change,
    Diagnosis,
    Experiment,
    ExperimentSweep,
    Finding,
    ProposedLaw,
    Rival,
    standing_of,
)
from service.model.results.effect import AxisFit, Effect, PoseGravity, PoseInertia, Value

if TYPE_CHECKING:  # the service composes documents of axes that its worker has diagnosed
    from service.diagnosis.diagnose import AxisResult, NamedEffect
    from service.diagnosis.experiments import NextExperiment
    from service.diagnosis.law import Law


def as_document(robot: Robot, diagnoses: "Sequence[AxisResult]") -> Diagnosis:
    """The result of all axes, with the model that results from the named effects."""
    return compose(robot, {one.joint: axis_document(one) for one in diagnoses})


def compose(robot: Robot, axes: Mapping[str, AxisDiagnosis]) -> Diagnosis:
    """The result of all axes, composed from those of single axes."""
    return Diagnosis(axes=dict(axes), model=model_of(robot, axes))


def axis_document(one: "AxisResult") -> AxisDiagnosis:
    """One axis; torques in N m (forces in N), see docs/reference/cli.md."""
    unit = one.unit
    found = AxisDiagnosis(
        verdict=one.verdict.value,
        unit=unit,
        effects=tuple(_effect(effect, unit) for effect in one.effects),
        known=tuple(_effect(effect, unit) for effect in one.known),
        part=tuple(_effect(effect, unit) for effect in one.part),
        changes=tuple(
            Change(effect=c.effect, parameter=c.parameter, model=_value(c.model, unit), now=_value(c.now, unit))
            for c in one.changes
        ),
        candidates=one.candidates,
        alternatives=one.alternatives,
        rivals=tuple(Rival(effect=effect, behind=behind) for effect, behind in one.rivals),
        rolled_back=one.rolled_back,
        where=tuple(cell.model_copy(update={"value": _in_units(cell.value, unit)}) for cell in one.cells),
        sentences=tuple(_in_units(sentence, unit) for sentence in one.sentences),
        gap=one.gap,
        example=one.example,
        fit=_fit(one),
        started_from=one.started_from,
        rigid_model=one.rigid_model,
        unexplained=one.unexplained,
        next_experiment=None if one.next_experiment is None else _experiment(one.next_experiment),
        untestable=one.untestable,
        biasing=one.biasing,
        data=tuple(Finding.model_validate(finding, from_attributes=True) for finding in one.data),
        visible_in={effect: CATALOGUE[effect].visible_in for effect in one.untestable},
        summary="",
    )
    told = {"summary": summary(one.joint, found, one.ended), "standing": standing_of(found)}
    law = None if one.law is None else _law(one.joint, one.law, unit)
    return found.with_nonempty(unfinished=one.unfinished, law=law, **told)


def _in_units(text: str, effort: str) -> str:
    """Correct the units for a prismatic axis (effort in N, no radians); the effects use revolute units for all axes."""
    return text if effort != "N" else re.sub(r"\brad([23]?)\b", r"m\1", re.sub(r"\bN m\b", "N", text))


def _effect(effect: "NamedEffect", unit: str) -> Effect:
    entry = CATALOGUE[effect.name]
    return Effect(
        effect=effect.name,
        sentence=entry.sentence,
        physics=entry.physics,
        source=entry.source,
        parameters={name: _value(parameter, unit) for name, parameter in effect.parameters.items()},
        covariance=tuple(map(tuple, effect.covariance.tolist())),
        evidence={"chi_squared_gain": effect.gain, "criterion_gain": effect.criterion_gain},
        scenario_entry=entry.entry,
        scenario=cast(Any, effect.patch),  # JSON
    )


def _law(joint: str, law: "Law", unit: str) -> ProposedLaw:
    return ProposedLaw(
        sentence=_in_units(law.sentence(joint, unit), unit),
        formula=law.formula,
        parameters={name: _value(parameter, unit) for name, parameter in law.parameters.items()},
        before_rms=law.before,
        after_rms=law.after,
        closed=law.closed,
        held_out_sweeps=law.sweeps,
    )


def _value(parameter: Parameter, unit: str) -> Value:
    return Value(value=parameter.value, std=parameter.std, unit=_in_units(parameter.unit, unit))


def _fit(one: "AxisResult") -> AxisFit:
    fit = one.fit
    inertias = zip(one.poses, fit.inertia.tolist(), fit.inertia_std.tolist(), strict=True)
    gravity = zip(one.poses, *fit.load[1:].tolist(), strict=True)
    return AxisFit(
        inertia=tuple(PoseInertia(pose=pose, value=value, std=std) for pose, value, std in inertias),
        gravity=tuple(PoseGravity(pose=pose, torque=torque, slope=slope) for pose, torque, slope in gravity),
        viscous_friction=Value(value=fit.viscous, std=fit.viscous_std),
        torques="true" if one.weighed else "recorded",
    )


def _experiment(experiment: "NextExperiment") -> Experiment:
    return Experiment(
        kind=experiment.kind,
        blocks=experiment.blocks,
        sweeps=tuple(
            ExperimentSweep(spec=SweepSpec(**sweep.spec.model_dump()), ramp=sweep.ramp, settle=sweep.settle)
            for sweep in experiment.sweeps
        ),
        seconds=experiment.seconds,
        separation=experiment.separation,
        between=experiment.between,
        reason=experiment.reason,
    )
