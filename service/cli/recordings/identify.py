"""The estimate of a bundle: the paper's Table 1, the base parameters and their quality from recorded sweeps."""

from collections.abc import Callable, Mapping
from pathlib import Path

from rich.console import Console
from rich.table import Table

from service.cli.documents import read_document
from service.cli.progress_indicator import counted, waiting
from service.cli.recordings.combination import print_combination
from service.errors import BadInput
from service.estimation import SweepSpectrum, estimate_document, sweep_spectrum
from service.identification.axis.ideal_frequency import Figure
from service.identification.axis.known_effects import KnownEffects, known_effects
from service.identification.axis.nominal_priors import TorqueGain
from service.identification.estimates.analysis_document import analyses_from
from service.identification.motion.free_motion import at_once, free_motions
from service.identification.motion.trajectory_record import runs_at_once
from service.identification.spectra.noise_response import has_reference
from service.recording import Sweep
from service.results.analysis import Analyses
from service.results.effect import Value
from service.results.estimate import BaseParameter, Estimate, EstimatedAxis, Rmse
from service.results.revision import KnownModel, ModelFile
from service.robot import Robot
from service.store.files.bundle import Bundle

_ROWS: tuple[tuple[str, Callable[[Rmse], float]], ...] = (
    ("reference - measurement", lambda rmse: rmse.reference_measured),
    ("identified - measurement", lambda rmse: rmse.identified_measured),
    ("reference - identified (workspace)", lambda rmse: rmse.reference_identified),
)


def identify_bundle(
    bundle: Bundle,
    axis: str | None,
    place: str,
    gains: Mapping[str, TorqueGain] | None = None,
    known: KnownEffects | None = None,
) -> Estimate:
    """The estimate of all sweeps or of those of one joint; BadInput if that leaves none."""
    if axis is not None:
        bundle.robot.index(axis)
    together = {spec.id for group in at_once([sweep.spec for sweep in bundle.sweeps]) for spec in group}
    motions = free_motions(bundle.robot, bundle.sweeps) if axis is None else ()
    sweeps = [
        sweep for sweep in bundle.sweeps if sweep.spec.id not in together and _of_axis(sweep, axis) and _tells(sweep)
    ]
    if not sweeps and not motions:
        of_joint = "" if axis is None else f" of joint {axis}"
        raise BadInput(place, f"has no sweep{of_joint} with sines, a trajectory or injected torque noise")
    spectra: list[SweepSpectrum] = [sweep_spectrum(bundle.robot, sweep) for sweep in counted(sweeps, "Sweeps")]
    with waiting("estimating"):
        return estimate_document(bundle.robot, spectra, gains=gains, known=known, motions=motions)


def read_effects(path: Path, robot: Robot) -> KnownEffects:
    """What `sweepid diagnose --model` wrote; BadInput names the file."""
    model = read_document(path, KnownModel, f"{path}: model")
    try:
        return known_effects(model, robot.joints, ModelFile(file=path.name))
    except BadInput as error:
        raise BadInput(f"{path}: {error.place}", error.reason) from None


def _of_axis(sweep: Sweep, axis: str | None) -> bool:
    """A trajectory of several axes is of none of them alone."""
    return axis is None or (sweep.spec.axis == axis and not runs_at_once(sweep.spec))


def _tells(sweep: Sweep) -> bool:
    """Of inertia or of the drive train."""
    return sweep.spec.shows_inertia or sweep.spec.stepped or has_reference(sweep)


def print_estimate(found: Estimate, console: Console) -> None:
    """Initial analysis, Table 1 of the paper for this robot, and the base parameters with standard deviation."""
    if found.analysis:
        _print_analysis(found.analysis, console)
    if found.combination is not None:
        print_combination(found.combination, console)
    axes = found.axes
    if not axes:
        return
    table = Table(title="RMSE of the axis inertias in percent")
    table.add_column("")
    for joint in axes:
        table.add_column(joint, justify="right")
    for label, size in _ROWS:
        table.add_row(label, *(f"{size(axis.rmse_percent):.2f}" for axis in axes.values()))
    table.add_row("sweeps", *(str(len(axis.inertia)) for axis in axes.values()), style="dim")
    console.print(table)

    table = Table(title="Base parameters, SI, about the joints' axes")
    table.add_column("parameter", overflow="fold")
    table.add_column("value", justify="right")
    table.add_column("std", justify="right")
    for parameter in found.base_parameters:
        table.add_row(_words(parameter), f"{parameter.value:.5g}", _number(parameter.std))
    console.print(table)
    for parameter in found.base_parameters:
        if parameter.reason:
            console.print(f"Not identified: {_words(parameter)}: {parameter.reason}", highlight=False)
    for symbol, of in found.symbols.items():
        console.print(f"  {symbol} = {of.value:.5g} {of.unit}, {of.meaning}", style="dim", highlight=False)
    _print_free_records(axes, console)
    for suspect in found.suspect:
        console.print(f"Suspect: sweep {suspect.sweep} of {suspect.axis}, {suspect.why}")
    for effect in found.effects:
        used = "Taken into account" if effect.used else "Left out"
        console.print(f"{used}: {effect.effect} of {effect.axis}, {effect.how}")
    console.print(f"Condition number of the observation matrix: {_number(found.condition_number)}")


def _print_analysis(analysis: Analyses, console: Console) -> None:
    """Pose by pose: where the load swings, where friction rules, and which frequency lies between them."""
    table = Table(title="Initial analysis; in brackets by asymptotes")
    for name in ("axis", "pose in rad", "J", "locked rotor, Hz", "friction below, Hz", "ideal, Hz", "sweep, Hz"):
        table.add_column(name, justify="left" if name in ("axis", "pose in rad") else "right")
    for joint, axis in analyses_from(analysis).items():
        for pose in axis.poses:
            fit, read = pose.fit, pose.asymptotes
            locked_rotor, ideal = _both(fit.locked_rotor, read.locked_rotor), _both(fit.frequency, read.frequency)
            if pose.at_least is not None:  # the asymptotes then end at a resonance that is none
                locked_rotor, ideal = (f"above {bound:.4g}" for bound in pose.at_least)
            table.add_row(
                joint,
                ", ".join(f"{position:.2f}" for position in pose.pose),
                _with_std(fit.inertia),
                locked_rotor,
                _both(fit.corner, read.corner),
                ideal,
                f"{fit.sweep_frequency:g}",
            )
    console.print(table)


def _both(fit: Figure, read: Figure) -> str:
    return f"{_with_std(fit)} ({read.value:.4g})"


def _with_std(figure: Figure) -> str:
    return f"{figure.value:.4g} ± {figure.std:.4g}"


def _print_free_records(axes: Mapping[str, EstimatedAxis], console: Console) -> None:
    """What else was found in records without lines, which are fitted one by one."""
    records = [(joint, sweep) for joint, axis in axes.items() for sweep in axis.inertia if sweep.terms]
    if not records:
        return
    table = Table(title="Records without lines, SI")
    for name in ("axis", "sweep", "term"):
        table.add_column(name)
    for name in ("value", "std"):
        table.add_column(name, justify="right")
    for joint, sweep in records:
        terms = {"inertia": Value(value=sweep.value, std=sweep.std), **sweep.terms}
        for name, term in terms.items():
            table.add_row(joint, sweep.sweep, name, f"{term.value:.5g}", _number(term.std))
    console.print(table)


def _words(parameter: BaseParameter) -> str:
    return parameter.name if parameter.symbolic is None else parameter.symbolic


def _number(value: float | None) -> str:
    return "undetermined" if value is None else f"{value:.3g}"
