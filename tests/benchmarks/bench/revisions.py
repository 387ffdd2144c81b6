"""From a sweep to the estimate's revision, and a campaign of 900 sweeps once more."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import cache

import numpy as np
from numpy.typing import NDArray

from service.estimation import SweepSpectrum, estimate_document, sweep_spectrum
from service.identification.estimates.estimate import moving_chain
from service.identification.model.base_parameters import base_parameters
from service.identification.spectra.frequency_response import window
from service.recording import Sweep
from service.robot import Robot
from tests.benchmarks.bench.measured import Measured, beside
from tests.benchmarks.bench.plant import random_poses
from tests.numeric.campaign import SimulatedCampaign, measure_at, scenario_named

Array = NDArray[np.float64]

POSES = 300
MOST_COMPUTE, MOST_CAMPAIGN = 0.010, 8.0  # s
LOOKS = 10  # revisions out of 900 that are timed for the sum over all


@cache
def campaign(poses: int = POSES) -> SimulatedCampaign:
    """Sweeps of axes 1 to 3 in random poses, as they would come: pose by pose."""
    found = measure_at(scenario_named("max100-full"), 7, random_poses(poses))
    return replace(found, sweeps=tuple(found.sweeps[axis * poses + k] for k in range(poses) for axis in range(3)))


@cache
def spectra(poses: int = POSES) -> list[SweepSpectrum]:
    found = campaign(poses)
    return [sweep_spectrum(found.robot, sweep) for sweep in found.sweeps]


def anew(robot: Robot, sweeps: Sequence[Sweep]) -> Array:
    """The paper's way, from nothing: FRF of each sweep, J by its formula, least squares in the base parameters."""
    poses, axes = np.array([s.spec.pose for s in sweeps]), [robot.index(s.spec.axis) for s in sweeps]
    values = np.array([_formula(sweep) for sweep in sweeps])
    moved = sorted(set(axes))
    chain, unlocked = moving_chain(robot, moved, poses)
    base = base_parameters(chain, tuple(unlocked.index(number) for number in moved))
    rows = np.empty((len(sweeps), len(base.columns)))
    for number in moved:
        own = np.flatnonzero(np.array(axes) == number)
        rows[own] = base.rows(chain, unlocked.index(number), poses[own][:, list(unlocked)])
    length = np.linalg.norm(rows, axis=0)
    scale = np.where(length > 0, length, 1.0)
    return np.linalg.lstsq(rows / scale, values, rcond=1e-9)[0] / scale


def _formula(sweep: Sweep) -> float:
    """Mean of |Im Z| / omega over the lines."""
    first, count = window(sweep.spec, sweep.recording.time)
    part = slice(first, first + count)
    frequency = np.array([sine.frequency for sine in sweep.spec.sines])
    bins = np.round(frequency * count / sweep.spec.sample_rate).astype(int)
    effort, velocity = (np.fft.rfft(x[part])[bins] for x in (sweep.recording.effort, sweep.recording.velocity))
    return float(np.mean(np.abs((effort / velocity).imag) / (2 * np.pi * frequency)))


def revision(robot: Robot, earlier: list[SweepSpectrum], sweep: Sweep) -> object:
    """What a job reckons: the spectrum of the new sweep, the estimate of all."""
    return estimate_document(robot, [*earlier, sweep_spectrum(robot, sweep)]).as_json()


def revisions(found: SimulatedCampaign, told: list[SweepSpectrum], last: int, repeats: int) -> Callable[[], object]:
    """Each call is the next revision of a campaign, `last` that of the last one: the fit of an axis whose sweeps did
    not change is kept from the revision before. The one before the first was made here."""
    numbers = iter(range(last - repeats, last + 1))

    def next_revision() -> object:
        number = next(numbers)
        return revision(found.robot, told[: number - 1], found.sweeps[number - 1])

    next_revision()
    return next_revision


def run() -> Iterator[Measured]:
    found = campaign()
    sweeps, robot = found.sweeps, found.robot
    revision(robot, spectra()[:5], sweeps[5])  # what is loaded once
    for count in (24, 90, 300, 900):
        at = beside(
            revisions(found, spectra(), count, 5),
            lambda n=count: anew(robot, sweeps[:n]),
            5,
        )
        told = at.as_measured(f"a revision, computing time only, sweep {count}", "FRF and least squares of all, again")
        yield replace(told, target=f"<= {MOST_COMPUTE * 1e3:g} ms", met=told.ours <= MOST_COMPUTE)
    whole = beside(
        lambda: estimate_document(robot, [sweep_spectrum(robot, s) for s in sweeps]), lambda: anew(robot, sweeps), 3
    )
    told = whole.as_measured("900 sweeps identified again, all at once", "FRF and least squares once")
    yield replace(told, target=f"<= {MOST_CAMPAIGN:g} s", met=told.ours <= MOST_CAMPAIGN)
    yield each_time()


def each_time() -> Measured:
    """A revision after each of 900 sweeps: some are timed, the sum is that of the line between them."""
    found = campaign()
    numbers = np.unique(np.geomspace(3, len(found.sweeps), LOOKS).astype(int))
    sides = [
        beside(
            revisions(found, spectra(), n, 1),
            lambda n=n: anew(found.robot, found.sweeps[:n]), 1,
        )
        for n in map(int, numbers)
    ]  # fmt: skip
    every = np.arange(1, len(found.sweeps) + 1)
    ours, peer = (
        float(np.interp(every, numbers, [getattr(side, which)[0] for side in sides]).sum())
        for which in ("ours", "peer")
    )
    return Measured(
        name="900 sweeps identified again, a revision after each", unit="s", ours=ours, peer=peer,
        beside="FRF and least squares of all, each time", target=f"<= {MOST_CAMPAIGN:g} s", met=ours <= MOST_CAMPAIGN,
        note=f"sum of 900, estimated from {len(numbers)} of them",
    )  # fmt: skip


def quick() -> Iterator[Measured]:
    """60 sweeps."""
    found = campaign(20)
    told = spectra(20)
    at = beside(revisions(found, told, len(told), 9), lambda: anew(found.robot, found.sweeps), 9)
    yield at.as_measured("a revision of 60 sweeps", "FRF and least squares of all, again", best=True)
