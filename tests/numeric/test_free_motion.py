"""Whole robots from logs of free motion, computed by Pinocchio: values, standard deviations, prediction."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import sweepid
from service import BadInput
from service.formats.export.sheets.making import sheet
from service.identification.estimates.combination import AxisInertias, JointEstimate, combine
from service.identification.model import JointMotion
from service.identification.motion.free_motion import free_motions
from service.model import Sweep
from service.store.files.bundle import Bundle, read_bundle, write_bundle
from tests.numeric.free_motion import Truth, draw, log, program, wander

ROBOTS = range(100, 124)  # not those on which the method was worked out


def logs(truth: Truth, seed: int, compliance: np.ndarray | None = None) -> list[Sweep]:
    """Two runs of 40 s: programs with rests for odd seeds, wandering for even ones."""
    rng = np.random.default_rng(seed + 5000)
    kind, joints = (program if seed % 2 else wander), len(truth.robot.axes)
    return [
        sweep
        for run in range(2)
        for sweep in log(truth, kind(rng, joints), seed + 1000 * run, started_at=100.0 * run, compliance=compliance)
    ]


def identified(truth: Truth, sweeps: list[Sweep]) -> JointEstimate:
    return combine(truth.robot, (), (), free_motions(truth.robot, sweeps))


def z(found: JointEstimate, truth: Truth) -> np.ndarray:
    """Identified less true value of what counts as identified, in standard deviations."""
    keep = [parameter.identified for parameter in found.parameters]
    return ((found.solution.values - found.base.combination @ truth.parameters) / found.solution.std)[keep]


def prediction(found: JointEstimate, truth: Truth, seed: int) -> np.ndarray:
    """RMS error of every axis along a motion that was never measured, percent of the rated effort."""
    joints = len(truth.robot.axes)
    q, v, a = wander(np.random.default_rng(seed + 9000), joints)(np.arange(0, 30, 0.02))
    true = truth.rigid(q, v, a) + truth.viscous * v + truth.coulomb * np.sign(v) + truth.offset
    rated = np.array([axis.rated_effort for axis in truth.robot.axes])
    return 100 * np.sqrt(np.mean((found.effort(JointMotion(q, v, a)) - true) ** 2, axis=0)) / rated


def test_standard_deviations_keep_what_they_promise() -> None:
    """Coloured noise, a ripple that no model has, CAD that is off by some 10 %: 93 to 99 % within two deviations."""
    errors: list[np.ndarray] = []
    predicted: list[np.ndarray] = []
    shares: list[float] = []
    for seed in ROBOTS:
        truth = draw(seed, 3 + seed % 4)
        found = identified(truth, logs(truth, seed))
        errors.append(z(found, truth))
        predicted.append(prediction(found, truth, seed))
        shares.append(len(errors[-1]) / len(found.parameters))
    within = np.mean(np.abs(np.concatenate(errors)) < 2)
    percent = np.concatenate(predicted)
    print(f"{len(np.concatenate(errors))} parameters, {100 * within:.1f} % within two standard deviations")
    print(f"prediction: median {np.median(percent):.2f} %, worst {percent.max():.2f} % of the rated effort")
    print(f"identified: {100 * np.mean(shares):.0f} % of the base parameters, least {100 * min(shares):.0f} %")
    assert 0.93 < within < 0.99
    assert np.median(percent) < 0.5
    assert percent.max() < 3.0
    assert min(shares) > 0.8


@pytest.mark.parametrize("ripple", [0.0, 0.02])
def test_the_spread_grows_with_what_the_model_lacks(ripple: float) -> None:
    errors = [
        z(identified(truth, logs(truth, seed)), truth)
        for seed in range(130, 138)
        for truth in [draw(seed, 3 + seed % 4, ripple=ripple)]
    ]
    assert np.mean(np.abs(np.concatenate(errors)) < 2) > 0.88


def test_held_out_parts_are_predicted_down_to_the_floor() -> None:
    truth = draw(140, 5, ripple=0.0)
    motion = wander(np.random.default_rng(140), 5)
    sweeps = [s for k in range(2) for s in log(truth, motion, 140 + k, started_at=100.0 * k, block="same", repeat=k)]
    found = identified(truth, sweeps)
    for axis, quality in found.free_axes.items():
        assert quality.floor is not None
        assert 0.8 * quality.floor < quality.residual < 1.2 * quality.floor, axis
        assert quality.error < 1.5 * quality.floor, axis


def test_direct_encoders_take_the_springs_out() -> None:
    """Springs that swing at some 6 Hz with the rotor locked."""
    truth = draw(150, 4, ripple=0.0)
    inertia = np.array([np.ptp(truth.rigid(np.zeros((2, 4)), np.zeros((2, 4)), e * [[0], [1]])) for e in np.eye(4)])
    compliance = 1 / (inertia * (2 * np.pi * 6.0) ** 2)
    sweeps = logs(truth, 150, compliance)
    with_encoders = identified(truth, sweeps)
    blind = [replace(sweep, recording=replace(sweep.recording, load_position=None)) for sweep in sweeps]
    without = identified(truth, blind)
    assert np.mean(np.abs(z(with_encoders, truth)) < 2) > 0.85
    assert np.median(prediction(with_encoders, truth, 150)) < 0.3
    errors = [np.sqrt(np.mean(z(one, truth) ** 2)) for one in (with_encoders, without)]
    assert errors[0] < errors[1]


def test_a_bundle_of_free_motions_alone_is_identified(tmp_path: Path) -> None:
    truth = draw(160, 3)
    write_bundle(tmp_path / "b", truth.robot, logs(truth, 160))
    bundle = read_bundle(tmp_path / "b")
    estimate = sweepid.identify(bundle)
    document: Any = estimate.as_json()
    assert document["axes"] == {}
    with pytest.raises(BadInput, match=r"a sheet is made of: export the model instead"):
        sheet(truth.robot, estimate, "estimate")
    with pytest.raises(BadInput, match=r"moves an axis alone: measure it \(`sweepid plan --diagnosis`\)"):
        sweepid.diagnose(bundle)
    combination = document["combination"]
    assert [len(ids) for ids in combination["free_motions"]] == [3, 3]
    found = {parameter["name"]: parameter for parameter in combination["base_parameters"]}
    for joint, true in zip(truth.robot.joints, truth.coulomb, strict=True):
        dry = found[f"Fc({joint})"]
        assert dry["value"] == pytest.approx(true, abs=4 * dry["std"])
        assert dry["std_total"] == pytest.approx(0.05 * true, rel=0.2)
        axis = combination["free_motion_axes"][joint]
        assert axis["held_out_percent"] < 2
        assert axis["noise_floor_rms"] is None
    with pytest.raises(BadInput, match="no sweep of joint joint_1"):
        sweepid.identify(Bundle(bundle.robot, bundle.sweeps), "joint_1")


def test_sweeps_and_free_motion_are_one_estimate() -> None:
    """Inertias of the true robot in 12 poses, from Pinocchio, known to 0.2 %, beside one short log."""
    truth = draw(180, 4)
    poses = np.random.default_rng(180).uniform(-1.5, 1.5, (12, 4))
    sweeps: list[AxisInertias] = []
    for k, joint in enumerate(truth.robot.joints):
        unit = np.tile(np.eye(4)[k], (12, 1))
        still = np.zeros_like(unit)
        values = (truth.rigid(poses, still, unit) - truth.rigid(poses, still, still))[:, k]
        noisy = values * (1 + 0.002 * np.random.default_rng(k).standard_normal(12))
        sweeps.append(AxisInertias(joint, poses, noisy, np.diag((0.002 * values) ** 2), None, 1.0))
    motion = free_motions(truth.robot, log(truth, wander(np.random.default_rng(180), 4), 180, duration=15.0))
    alone, both = combine(truth.robot, (), (), motion), combine(truth.robot, sweeps, (), motion)
    assert np.mean(np.abs(z(both, truth)) < 2) > 0.85
    shown = np.array(both.base.columns) < 11 * len(truth.robot.axes)  # sweeps contain no friction
    assert (both.solution.std <= alone.solution.std * 1.2)[shown].all()
    assert np.median((both.solution.std / alone.solution.std)[shown]) < 0.9
    by_name = {parameter.name: parameter for parameter in both.parameters}
    assert by_name["Fc(joint_1)"].source == "trajectories"


def test_an_axis_without_a_record_stood(tmp_path: Path) -> None:
    """Its equation is missing, what it carries is moved by the others."""
    truth = draw(170, 4)

    def path(time: np.ndarray) -> np.ndarray:
        whole = wander(np.random.default_rng(170), 4)(time)
        whole[0, :, 3], whole[1:, :, 3] = 0.4, 0.0
        return whole

    found = identified(truth, [s for s in log(truth, path, 170) if s.spec.axis != "joint_4"])
    by_name = {parameter.name: parameter for parameter in found.parameters}
    assert by_name["Fc(joint_4)"].reason == "no sweep and no trajectory shows it"
    assert by_name["Fc(joint_2)"].identified
    assert np.mean(np.abs(z(found, truth)) < 2) > 0.85
