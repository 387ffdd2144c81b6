"""The diagnosis of a bundle: where model and measurement disagree, what is missing, and what to measure next."""

import hashlib
from collections.abc import Sequence
from pathlib import Path

import yaml
from rich.console import Console
from rich.table import Table

from service.cli.documents import read_document, write_file
from service.cli.progress_indicator import counted
from service.diagnosis import AxisDiagnosis, as_document, diagnose_axis, is_evidence, started_from
from service.diagnosis.start import CAD
from service.errors import BadInput
from service.report.gap_figures import measured, number
from service.results.diagnosis import DiagnosedModel, Diagnosis, RigidParameter
from service.results.effect import Effect
from service.results.estimate import Estimate
from service.robot import Robot
from service.store.files.bundle import Bundle

_SIZES = ("before", "after", "noise floor", "twin")


def write_scenario(path: Path, robot: Robot, model: DiagnosedModel) -> None:
    """The model's scenario, which the virtual machine can load: with the robot's description and URDF beside it."""
    description = robot.description.model_dump(mode="json") | {"urdf": f"{path.stem}-robot.urdf"}
    files = {
        description["urdf"]: robot.urdf_text,
        f"{path.stem}-robot.yaml": yaml.safe_dump(description, sort_keys=False),
        path.name: yaml.safe_dump({**model.scenario, "robot": f"{path.stem}-robot.yaml"}, sort_keys=False),
    }
    for name, text in files.items():
        write_file(path.parent / name, text)


def diagnose_bundle(
    bundle: Bundle,
    axis: str | None,
    place: str,
    known: Sequence[str] = (),
    estimate: Path | None = None,
    *,
    twin: bool = True,
) -> Diagnosis:
    """The document of all axes that were swept, or of one; BadInput if that leaves none.

    `estimate`: file of an estimate from which the rigid model starts; BadInput if it is of another robot.
    """
    robot = bundle.robot
    if estimate is not None:
        document = read_document(estimate, Estimate).as_json()
        source = f"{estimate.name}, sha256 {hashlib.sha256(estimate.read_bytes()).hexdigest()}"
        robot = started_from(robot, document, source, str(estimate))
    if axis is not None:
        bundle.robot.index(axis)
    swept = {sweep.spec.axis for sweep in bundle.sweeps if is_evidence(sweep.spec)}
    joints = [joint for joint in bundle.robot.joints if joint in swept and axis in (None, joint)]
    if not joints:
        raise BadInput(place, "has no sweep that moves" + ("" if axis is None else f" joint {axis}"))
    found: list[AxisDiagnosis] = [
        diagnose_axis(robot, joint, bundle.sweeps, known={name: {} for name in known}, twin=twin)
        for joint in counted(joints, "Axes")
    ]
    return Diagnosis.read(as_document(bundle.robot, found), place)


def print_diagnosis(document: Diagnosis, console: Console) -> None:
    """Verdict and gap of each axis; the same in words, where the gap is, the parameters, and what to measure next.

    "twin" is what the simulator leaves with the model that is handed on.
    """
    table = Table(title="Diagnosis; gap, RMS")
    for name in ("axis", "verdict", "effects", *_SIZES, ""):
        table.add_column(name, no_wrap=name in ("axis", "effects"), justify="right" if name in _SIZES else "left")
    for joint, axis in document.axes.items():
        names = axis.candidates or [effect.effect for effect in axis.effects]
        gap = axis.gap
        sizes = (gap.before_rms, gap.after_rms, gap.noise_floor_rms, gap.twin_rms)
        table.add_row(
            joint,
            axis.verdict,
            (" or " if axis.candidates else ", ").join(names) or "-",
            *("-" if size is None else f"{size:.4g}" for size in sizes),
            axis.unit,
        )
    console.print(table)
    for joint, axis in document.axes.items():
        console.print(axis.summary)
        if axis.started_from != CAD:
            console.print(f"  The rigid model started from {axis.started_from}.", highlight=False, soft_wrap=True)
        for sentence in axis.sentences:
            console.print(f"  {sentence}")
        for search in axis.unfinished:
            console.print(f"  Warning: {search.sentence} {search.action}")
        for effect in axis.effects:
            _print_effect(effect, "If it is that: " if effect.effect in axis.candidates else "", console)
        for effect in axis.part:
            _print_effect(effect, "Part of it, in addition to an unknown effect: ", console)
        console.print(_rigid_table(joint, axis.rigid_model, "CAD" if axis.started_from == CAD else "estimate"))
        if axis.next_experiment is not None:
            console.print(f"{joint}: next, {axis.next_experiment.kind}. {axis.next_experiment.reason}")


def _print_effect(effect: Effect, before: str, console: Console) -> None:
    console.print(f"  {before}{effect.sentence}")
    for name, value in effect.parameters.items():
        console.print(f"    {name} = {measured(value)}")


def _rigid_table(joint: str, parameters: Sequence[RigidParameter], before: str) -> Table:
    """What CAD and data sheet, or an estimate, say of the rigid model, and what these sweeps say."""
    table = Table(title=f"{joint}: rigid model, base parameters")
    for name in ("parameter", before, "found", "± std"):
        table.add_column(name, justify="left" if name == "parameter" else "right")
    for one in parameters:
        nominal = "-" if one.nominal is None else f"{one.nominal:.4g}"
        table.add_row(one.name, nominal, f"{one.value:.4g}", f"{number(one.std):.2g}")
    return table
