"""From sweeps to estimates and causes: a revision against the paper's way, the regressor against Pinocchio, the base
parameters against column-pivoted QR, the diagnosis of an axis against the time in which its sweeps are measured."""

import json
from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import cache

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray
from scipy.linalg import qr, solve_triangular

from docs.benchmarks.measured import Measured, beside, timed
from docs.benchmarks.plant import random_poses
from service.diagnosis import diagnose_axis
from service.identification.estimates.estimate import moving_chain
from service.identification.estimates.update import Condensed
from service.identification.estimation import (
    SweepSpectrum,
    condensed_estimate,
    estimate_document,
    sweep_spectrum,
    updated_estimate,
)
from service.identification.model import (
    Independence,
    axis_rows,
    inertia_rows,
    joint_ranges,
    parameter_names,
    reduce_columns,
)
from service.identification.model.base_parameters import base_parameters
from service.identification.spectra.frequency_response import window
from service.model import Robot, Sweep
from tests.numeric.campaign import SimulatedCampaign, max100, measure_at, scenario_named
from tests.numeric.second_plant.cases import Kind, case, make

Array = NDArray[np.float64]

POSES, REPEATS = 300, 9
MOST_COMPUTE, MOST_CAMPAIGN = 0.015, 8.0  # s
PEER, PEER_ONCE = "FRF, least squares", "FRF and least squares once"
CASES = {
    "nothing hidden": case(11, 1000, Kind.NONE, (), "none"),
    "Coulomb friction": case(11, 20_000, Kind.SINGLE, ("coulomb_friction",)),
    "elasticity": case(11, 21_000, Kind.SINGLE, ("joint_elasticity",)),
    "cogging": case(11, 22_000, Kind.SINGLE, ("cogging_torque",)),
}


@cache
def campaign(poses: int = POSES) -> SimulatedCampaign:
    """Sweeps of axes 1 to 3 in random poses, as they would come: pose by pose."""
    found = measure_at(scenario_named("max100-full"), 7, random_poses(poses))
    return replace(found, sweeps=tuple(found.sweeps[axis * poses + k] for k in range(poses) for axis in range(3)))


def spectra(found: SimulatedCampaign) -> list[SweepSpectrum]:
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


class Revisions:
    """Each call is the next revision of a campaign, after `done` sweeps: spectrum of the new sweep, estimate updated by
    it, or fitted to all sweeps where the update ends."""

    def __init__(self, found: SimulatedCampaign, told: list[SweepSpectrum], done: int) -> None:
        self.found, self.told, self.done, self.fits = found, told, done, 0
        self.condensed = self._fitted()

    def _fitted(self) -> Condensed:
        condensed = condensed_estimate(self.found.robot, self.told[: self.done], {}, None)[1]
        if condensed is None:
            raise ValueError(f"{self.done} sweeps do not determine the base parameters")
        return condensed

    def __call__(self) -> Condensed:
        new = sweep_spectrum(self.found.robot, self.found.sweeps[self.done])
        self.done += 1
        after = updated_estimate(self.condensed, [new])
        self.fits += after is None
        self.condensed = after or self._fitted()
        return self.condensed


def by_pinocchio(robot: Robot, poses: Array) -> Array:
    """Rows (axes, m, 10 n): torque of a unit acceleration without gravity, a call an axis and pose."""
    model = pin.buildModelFromXML(robot.urdf_text)
    model.gravity.linear = np.zeros(3)
    data, still, units = model.createData(), np.zeros(model.nv), np.eye(model.nv)
    rows = np.empty((model.nv, len(poses), 10 * model.nv))
    for m, pose in enumerate(poses):
        for axis, unit in enumerate(units):
            rows[axis, m] = pin.computeJointTorqueRegressor(model, data, pose, still, unit)[axis]
    return rows


def by_qr(rows: Array) -> tuple[list[int], Array]:
    """Independence and regrouping by column-pivoted QR (Gautier 1991)."""
    length = np.linalg.norm(rows, axis=0)
    scaled = rows / np.where(length > Independence.tolerance * length.max(), length, 1.0)
    triangle, order = qr(scaled, mode="r", pivoting=True)
    size = np.abs(np.diag(triangle))
    rank = int(np.sum(size > 1e3 * Independence.tolerance * size[0]))
    return order[:rank].tolist(), solve_triangular(triangle[:rank, :rank], triangle[:rank, rank:])


def rows_compared(poses: int, repeats: int, *, best: bool = False) -> Iterator[Measured]:
    robot = max100()
    lower, upper = joint_ranges(robot.chain)
    at = np.random.default_rng(0).uniform(lower, upper, (poses, len(lower)))
    found = beside(
        lambda: np.stack([inertia_rows(robot.chain, axis, at) for axis in range(6)]),
        lambda: by_pinocchio(robot, at),
        repeats,
    )
    apart = float(np.abs(found.mine - found.theirs).max() / np.abs(found.theirs).max())
    yield found.as_measured(
        "regressor of six axes", "Pinocchio, one call per axis and pose", amount=6 * poses, unit="rows/s", best=best,
        note=f"largest difference {apart:.0e}",
    )  # fmt: skip
    tall, names = np.vstack([axis_rows(robot.chain, axis, at) for axis in range(6)]), parameter_names(robot.chain)
    base = beside(lambda: reduce_columns(tall, names), lambda: by_qr(tall), repeats)
    yield base.as_measured(
        f"base parameters of {len(tall)} x {tall.shape[1]}", "column-pivoted QR with its regrouping", best=best,
        note=f"ranks {len(base.mine.columns)} and {len(base.theirs[0])}",
    )  # fmt: skip


def run() -> Iterator[Measured]:
    found = campaign()
    sweeps, robot, told = found.sweeps, found.robot, spectra(found)
    Revisions(found, told, 24)()  # what is loaded once
    for count in (24, 90, 300, 900):
        ours = Revisions(found, told, min(count, len(told) - REPEATS))
        at = beside(ours, lambda n=count: estimate_document(robot, told[:n]), REPEATS)
        of = at.as_measured(f"a revision, sweep {count}", "fit of all")
        size = len(json.dumps(ours.condensed.document)) / 1e3
        fits = f"{ours.fits} of {REPEATS} by it; {size:.0f} kB"
        yield replace(of, target=f"<= {MOST_COMPUTE * 1e3:g} ms", met=of.ours <= MOST_COMPUTE, note=fits)
    whole = beside(lambda: estimate_document(robot, spectra(found)), lambda: anew(robot, sweeps), 3)
    of = whole.as_measured("900 sweeps identified again, all at once", PEER_ONCE)
    yield replace(of, target=f"<= {MOST_CAMPAIGN:g} s", met=of.ours <= MOST_CAMPAIGN)
    yield from rows_compared(10_000, 3)
    for name, one in CASES.items():
        robot, joint, sweeps, _ = make(one)
        seconds, axis = timed(lambda robot=robot, joint=joint, sweeps=sweeps: diagnose_axis(robot, joint, sweeps))
        machine = sum(float(sweep.recording.time[-1] - sweep.recording.time[0]) for sweep in sweeps)
        yield Measured(
            name=f"diagnosis of one axis, {name}", unit="s", ours=seconds, peer=machine,
            beside="measuring its sweeps", note=f"{len(sweeps)} sweeps: {axis.verdict.value}",
        )  # fmt: skip


def quick() -> Iterator[Measured]:
    """60 sweeps; 1,000 poses."""
    found = campaign(20)
    told = spectra(found)
    at = beside(Revisions(found, told, len(told) - 11), lambda: anew(found.robot, found.sweeps), 9)
    yield at.as_measured("a revision of 60 sweeps", PEER, best=True)
    yield from rows_compared(1000, 5, best=True)
