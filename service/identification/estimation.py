"""From recorded sweeps to the document of the estimate, for the service's worker and for `sweepid identify`."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from service.identification.axis.ideal_frequency import InitialAnalysis
from service.identification.axis.known_effects import KnownEffects
from service.identification.axis.nominal_priors import TorqueGain
from service.identification.estimates.combination import combination_document, combine, inertias_of
from service.identification.estimates.document import as_document, nothing_known
from service.identification.estimates.estimate import RobotEstimate, identify
from service.identification.estimates.initial_analysis import analyse, analyses_document
from service.identification.estimates.robot_type import RobotType
from service.identification.estimates.update import Condensed
from service.identification.motion.free_motion import FreeMotion
from service.identification.motion.trajectory_record import AxisTrack, axis_track, runs_at_once, trajectories
from service.identification.spectra.frequency_response import Spectrum, spectrum
from service.identification.spectra.noise_response import NoiseSpectrum, has_reference, noise_spectrum
from service.model import Array, Robot, Sweep
from service.model.collision import reachable
from service.model.results import estimate as results
from service.model.results.spectrum import AnySpectrum

SweepSpectrum = Spectrum | NoiseSpectrum | AxisTrack


def sweep_spectrum(robot: Robot, sweep: Sweep) -> SweepSpectrum:
    """The stored spectrum of a sweep; BadInput if the record is shorter than the sweep."""
    if runs_at_once(sweep.spec):
        return axis_track(robot.without_counterbalance(sweep))
    return noise_spectrum(robot, sweep) if has_reference(sweep) else spectrum(robot, sweep)


def spectrum_from(document: AnySpectrum) -> SweepSpectrum:
    """The inverse of `to_document` for all kinds."""
    if "harmonics" in document:
        return AxisTrack.from_document(document)
    if "reference" in document:
        return NoiseSpectrum.from_document(document)
    return Spectrum.from_document(document)


def estimate_document(
    robot: Robot,
    spectra: Sequence[SweepSpectrum],
    analyses: Mapping[str, InitialAnalysis] | None = None,
    gains: Mapping[str, TorqueGain] | None = None,
    known: KnownEffects | None = None,
    motions: Sequence[FreeMotion] = (),
    earlier: RobotType | None = None,
) -> results.Estimate:
    """Identify, and compare with the nominal model over the poses of the workspace without self-collision.

    The initial analysis of noise runs and stepped sines among the `spectra` becomes "analysis"; it is the prior of
    its axes' drive trains, as are `analyses` of other campaigns for axes without one. `gains`: calibrated with a test
    mass, by joint. `known`: effects of the robot's model, for the sweeps with lines. With trajectories of several axes
    and free `motions`, "combination" is the joint estimate from sweeps and these; else it is null.
    Spectra of sweeps in `motions` contain no information about a single axis and are ignored. `earlier`: robots of the
    type, a prior of the axis inertias' base parameters.
    """
    return _fitted(robot, spectra, analyses or {}, gains or {}, known, motions, earlier).document


def condensed_estimate(
    robot: Robot, spectra: Sequence[SweepSpectrum], analyses: Mapping[str, InitialAnalysis], known: KnownEffects | None
) -> tuple[results.Estimate, Condensed | None]:
    """`estimate_document`, and what the next revision needs of the spectra; None if that needs all of them."""
    found = _fitted(robot, spectra, analyses, {}, known, ())
    if found.estimate is None or any(isinstance(each, AxisTrack) for each in spectra):
        return found.document, None
    sweeps = [each for each in spectra if isinstance(each, Spectrum)]
    return found.document, Condensed.of(found.estimate, sweeps, found.workspace, found.document)


@dataclass(frozen=True)
class _Fitted:
    """The estimate of single axes, None without one, with the poses (m, all joints) of the workspace."""

    document: results.Estimate
    estimate: RobotEstimate | None
    workspace: Array


def _fitted(
    robot: Robot,
    spectra: Sequence[SweepSpectrum],
    analyses: Mapping[str, InitialAnalysis],
    gains: Mapping[str, TorqueGain],
    known: KnownEffects | None,
    motions: Sequence[FreeMotion],
    earlier: RobotType | None = None,
) -> _Fitted:
    sweeps = [each for each in spectra if isinstance(each, Spectrum)]
    together = {id for motion in motions for id in motion.ids}
    sweeps = [sweep for sweep in sweeps if sweep.spec.id not in together]
    runs = [each for each in spectra if isinstance(each, NoiseSpectrum)]
    own = analyse(robot, runs, [sweep for sweep in sweeps if sweep.spec.stepped])
    estimate = None
    if any(sweep.spec.shows_inertia for sweep in sweeps):
        estimate = identify(robot, sweeps, {**analyses, **own}, gains, known, earlier)
    records = trajectories(robot, [each for each in spectra if isinstance(each, AxisTrack)])
    combination = None
    if records or motions:
        inertias = inertias_of(estimate) if estimate else ()
        combination = combination_document(combine(robot, inertias, records, motions, gains))
    also: dict[str, object] = {"analysis": analyses_document(own), "combination": combination}
    if estimate is None and combination is not None:
        also |= {"standard_parameters": combination.standard_parameters, "physical": combination.physical}
    if estimate is None:
        return _Fitted(nothing_known().model_copy(update=also), None, np.empty((0, len(robot.joints))))
    workspace = reachable(robot, estimate.poses, estimate.workspace)
    return _Fitted(as_document(estimate, workspace).model_copy(update=also), estimate, workspace)


def updated_estimate(before: Condensed, spectra: Sequence[SweepSpectrum]) -> Condensed | None:
    """The revision with these spectra more; None if it needs all sweeps."""
    found: Condensed | None = before
    for each in spectra:
        found = found.updated(each) if found is not None and isinstance(each, Spectrum) else None
    return found
