"""A revision by one more sweep is the fit of all sweeps, at a cost that does not depend on their number."""

from dataclasses import replace
from functools import cache
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.stats import chi2

from service.identification.axis import joint_fit
from service.identification.estimates import update
from service.identification.estimates.update import Condensed
from service.identification.estimation import condensed_estimate, estimate_document, sweep_spectrum
from service.identification.spectra.frequency_response import Spectrum
from service.jobs.work import Job, Revisions
from service.model import Robot
from service.store.files.recordings import SpectrumFile, encode_spectrum
from tests.numeric.campaign import measure_at, scenario_named

Campaign = tuple[Robot, list[Spectrum]]
AXES = 3


@cache
def campaign(seed: int, poses: int = 16) -> Campaign:
    """Noisy sweeps of three elastic axes with friction in random poses, pose by pose."""
    rng, where = np.random.default_rng(seed), np.zeros((poses, 6))
    where[:, 1], where[:, 2] = rng.uniform(-1.2, 1.2, poses), rng.uniform(-2.0, 1.2, poses)
    found = measure_at(scenario_named("max100-full"), seed, where)
    spectra = [
        sweep_spectrum(found.robot, found.sweeps[axis * poses + k]) for k in range(poses) for axis in range(AXES)
    ]
    return found.robot, [one for one in spectra if isinstance(one, Spectrum)]


def condensed(robot: Robot, spectra: list[Spectrum]) -> Condensed:
    found = condensed_estimate(robot, spectra, {}, None)[1]
    assert found is not None
    return found


def updated(robot: Robot, spectra: list[Spectrum], first: int) -> Condensed:
    """The revisions after the first sweeps, with a fit of all where the trust region ends."""
    found = condensed(robot, spectra[:first])
    for number in range(first, len(spectra)):
        found = found.updated(spectra[number]) or condensed(robot, spectra[: number + 1])
    return found


@pytest.mark.parametrize("seed", [1, 2])
def test_an_update_is_the_fit_of_all_sweeps(seed: int) -> None:
    robot, spectra = campaign(seed)
    most = 0
    for last in (34, 48):
        found = updated(robot, spectra[:last], 24)
        most = max(most, found.updates)
        new: dict[str, Any] = found.document.as_json()
        whole: dict[str, Any] = estimate_document(robot, spectra[:last]).as_json()
        for joint, axis in whole["axes"].items():
            for name, of in axis["drive_train"].items():
                mine = new["axes"][joint]["drive_train"][name]
                assert abs(mine["value"] - of["value"]) < 0.01 * of["std"]
                assert mine["std"] == pytest.approx(of["std"], rel=0.01)
            for mine, of in zip(new["axes"][joint]["inertia"], axis["inertia"], strict=True):
                assert mine["sweep"] == of["sweep"]
                assert abs(mine["value"] - of["value"]) < 0.01 * of["std"]
                assert mine["std"] == pytest.approx(of["std"], rel=0.01)
        assert new.keys() - {"updates"} == whole.keys()
    assert most > 0


@pytest.mark.parametrize("seed", [1, 2])
def test_the_linear_part_is_the_least_squares_of_all_sweeps(seed: int) -> None:
    """Compared with `lstsq` of the whitened rows of all sweeps, whose covariance is written out."""
    robot, spectra = campaign(seed, 24)
    found = updated(robot, spectra, 60)
    start = found.estimate.solution.values
    rows, values, covariances = [], [], []
    for axis in found.axes.values():
        by_train = axis.sweeps.by_train
        covariance = by_train @ np.linalg.inv(axis.train.precision) @ by_train.T
        covariances.append(covariance + axis.ratio * np.diag(axis.sweeps.variance))
        rows.append(axis.sweeps.rows)
        values.append(axis.inertias(start))
    scales = np.ones(AXES)
    for _ in range(2):  # the second time with the covariance increased where the misfit is beyond chance
        whites = [np.linalg.inv(np.linalg.cholesky(c * scale)) for c, scale in zip(covariances, scales, strict=True)]
        white = np.vstack([w @ r for w, r in zip(whites, rows, strict=True)])
        right = np.concatenate([w @ v for w, v in zip(whites, values, strict=True)])
        solution = np.linalg.lstsq(white, right, rcond=None)[0]
        basis, edges = np.linalg.qr(white)[0], np.cumsum([0, *map(len, values)])
        for k, (a, b) in enumerate(pairwise(edges)):
            squares, freedom = np.sum((right - white @ solution)[a:b] ** 2), b - a - np.sum(basis[a:b] ** 2)
            if squares > chi2.isf(joint_fit.FitLimits.chance, freedom):
                scales[k] = squares / freedom
    document: dict[str, Any] = found.document.as_json()
    told = np.array([one["value"] for one in document["base_parameters"]])
    assert all(one["std"] is not None for one in document["base_parameters"])
    np.testing.assert_allclose(told, solution, rtol=1e-9, atol=1e-9 * np.abs(solution).max())


def test_an_update_in_the_trust_region_evaluates_the_new_sweep_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(update, "TRUST", 10.0)
    evaluated: list[int] = []
    residual = joint_fit.stack_residual

    def counted(stack: Any, shared: Any, own: Any) -> Any:
        evaluated.append(len(own))
        return residual(stack, shared, own)

    monkeypatch.setattr(joint_fit, "stack_residual", counted)
    costs: list[int] = []
    for poses in (16, 40):
        robot, spectra = campaign(1, poses)
        before = condensed(robot, spectra[:-3])
        evaluated.clear()
        assert any(before.updated(one) is not None for one in spectra[-3:])
        costs.append(sum(evaluated))
    assert max(costs) <= 3 * 30  # steps of three fits, whatever the number of sweeps before


def test_a_sweep_outside_of_the_trust_region_needs_all() -> None:
    robot, spectra = campaign(2)
    before, new = condensed(robot, spectra[:45]), spectra[45:]
    assert any(before.updated(one) is not None for one in new)
    spike = [np.exp(-2j * np.pi * one.frequency * 0.7) * np.abs(one.effort).max() / 50 for one in new]
    spoilt = {
        "spike": [replace(one, effort=one.effort + by) for one, by in zip(new, spike, strict=True)],
        "another payload": [replace(one, effort=1.1 * one.effort) for one in new],
        "sample rate": [replace(one, spec=one.spec.model_copy(update={"sample_rate": 500.0})) for one in new],
        "earlier": [replace(one, spec=one.spec.model_copy(update={"id": "0000"})) for one in new],
    }
    for name, sweeps in spoilt.items():
        assert [before.updated(one) for one in sweeps] == [None] * AXES, name


def test_a_worker_continues_only_what_it_made(tmp_path: Path) -> None:
    """From the files of the sweeps before; other files, or the last sweep, give the fit of all sweeps."""
    robot, spectra = campaign(1)

    def file(number: int) -> SpectrumFile:
        content, sha256 = encode_spectrum(spectra[number].to_document())
        path = tmp_path / str(number)
        path.write_bytes(content)
        return SpectrumFile(path, sha256)

    def job(count: int, last: bool = False) -> Job:
        earlier = tuple(map(file, range(count - 1)))
        return Job(
            "", robot.description, robot.urdf_text, sweeps=(), earlier=earlier, analyses={}, siblings={}, last=last
        )

    def updates(revisions: Revisions, count: int, last: bool = False) -> object:
        return revisions.next(job(count, last), robot, spectra[count - 1 : count]).get("updates", 0)

    revisions = Revisions()
    counts = [updates(revisions, count) for count in range(40, 47)]
    assert counts[0] == 0
    assert max(map(int, map(str, counts))) > 0
    assert updates(revisions, 48) == 0  # of 47 it knows nothing
    assert updates(revisions, 47) == 0
    assert revisions.next(job(48, last=True), robot, spectra[47:]) == estimate_document(robot, spectra).as_json()
