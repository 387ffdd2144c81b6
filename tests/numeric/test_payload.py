"""A body mounted on the last link, from free motions that Pinocchio computed and from sweeps of the virtual machine."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from service import BadInput
from service.identification.estimates.torque_gain import KnownMass
from service.identification.payloads import PayloadFit, body_of, payload, planned_mass_std, sentences
from service.model import Sine, Sweep
from service.store.files.bundle import write_bundle
from simulator import LinkDeviation
from simulator.scenario import AddedBody
from sweepid import payload as payload_of
from tests.command import sweepid
from tests.numeric.campaign import measure_at, scenario_named
from tests.numeric.free_motion import PAYLOAD, Truth, draw, log, program, wander
from tests.numeric.second_plant.logs import log as log_of_plant

ROBOTS = range(200, 212)
UNLOADED = [820, 821, 822, 824, 825, 826]  # the same
OTHER_ARMS = [300, 301, 302, 304, 305, 306, 308, 309, 310, 312]  # seeds % 4 < 3: arms


def warmer(truth: Truth) -> Truth:
    """Hours later: friction has changed."""
    return replace(truth, viscous=0.93 * truth.viscous, coulomb=1.04 * truth.coulomb, offset=1.1 * truth.offset)


def before_and_after(truth: Truth, seed: int, twist: float = 0.0) -> tuple[list[Sweep], list[Sweep]]:
    """`twist`: of each gear under the rated effort, rad, without direct encoders; its paths have continuous jerk."""
    rng = np.random.default_rng(seed + 5000)
    path = (program if seed % 2 and not twist else wander)(rng, len(truth.robot.axes))
    compliance = np.array([twist / axis.rated_effort for axis in truth.robot.axes]) if twist else None
    records = (
        log(truth, path, seed, compliance=compliance),
        log(warmer(truth.with_payload(PAYLOAD)), path, seed + 1, started_at=900.0, compliance=compliance),
    )
    before, after = ([replace(s, recording=replace(s.recording, load_position=None)) for s in one] for one in records)
    return before, after


def off(found: PayloadFit, body: np.ndarray = PAYLOAD) -> np.ndarray:
    """In standard deviations, of [m, c, I about c]; NaN where it was not excited."""
    return np.where(found.excited, (found.body - body_of(body)) / found.body_std, np.nan)


@pytest.mark.parametrize("twist", [0.0, 0.01])
def test_free_motions_tell_the_payload(twist: float) -> None:
    """40 s each, before and after; robots of 3 to 6 axes of 100 kg and more, with 8 kg; stiff, and on springs."""
    found: list[PayloadFit] = []
    for seed in ROBOTS:
        truth = draw(seed, 3 + seed % 4)
        found.append(payload(truth.robot, *before_and_after(truth, seed, twist)))
    z = np.concatenate([off(one) for one in found])
    z = z[np.isfinite(z)]
    errors = np.array([np.where(one.excited, one.body - body_of(PAYLOAD), np.nan) for one in found])
    stds = np.array([np.where(one.excited, one.body_std, np.nan) for one in found])
    parts = (("mass", slice(0, 1), "kg"), ("center", slice(1, 4), "m"), ("inertia", slice(4, 10), "kg m2"))
    for name, part, unit in parts:
        size, std = np.nanmedian(np.abs(errors[:, part])), np.nanmedian(stds[:, part])
        seen = np.mean(np.isfinite(errors[:, part]))
        print(f"{name}: median error {size:.3g}, median std {std:.3g} {unit}, {100 * seen:.0f} % excited")
    print(f"{len(z)} figures, {100 * np.mean(np.abs(z) < 2):.1f} % within two standard deviations")
    assert 0.90 < np.mean(np.abs(z) < 2) <= 1.0
    assert np.nanmedian(np.abs(errors[:, 0])) < 0.02 * PAYLOAD[0]
    assert np.nanmedian(np.abs(errors[:, 1:4])) < 0.02
    assert np.mean(np.isfinite(errors[:, :4])) > 0.9


@pytest.mark.filterwarnings("error")
def test_a_payload_of_another_plant() -> None:
    """Arms of the second plant with stiff gears, hours later: mass within 2 % or its std, repeats within 2 %."""
    found: list[tuple[float, float, float]] = []
    for seed in OTHER_ARMS:
        bare, loaded = (log_of_plant(seed, family="arm", elastic=False, payload=part) for part in (0.0, 0.1))
        true = float((loaded.links - bare.links)[-1, 0])
        before, after = (
            [_begun(sweep, 1000.0 * later) for sweep in (*one.sweeps, *one.held_out)]
            for later, one in enumerate((bare, loaded))
        )
        fit = payload(bare.robot, before, after)
        spread = (max(fit.repeats) - min(fit.repeats)) / true
        mass, std = fit.body[0] / true - 1, fit.body_std[0] / true
        print(f"{seed} {bare.kind.motion}: {true:.3f} kg, off {mass:+.2%}, std {std:.2%}, repeats {spread:.2%}")
        assert any("Repeatability: 2 motions" in note for note in sentences(fit))
        found.append((abs(mass), std, spread))
    off_by, std, spread = np.array(found).T
    assert np.mean(off_by <= np.maximum(0.02, std)) >= 0.9
    assert np.median(spread) <= 0.02


def _begun(sweep: Sweep, at: float) -> Sweep:
    return replace(sweep, spec=sweep.spec.model_copy(update={"started_at": sweep.spec.started_at + at}))


def test_a_torque_constant_is_in_the_total() -> None:
    truth = draw(230, 4)
    before, after = before_and_after(truth, 230)
    first, second = (
        [replace(s, recording=replace(s.recording, effort=1.05 * s.recording.effort)) for s in part]
        for part in (before, after)
    )
    found = payload(truth.robot, first, second)
    assert found.body[0] == pytest.approx(1.05 * PAYLOAD[0], abs=3 * found.body_std[0])
    assert found.body_std_total[0] > 0.02 * PAYLOAD[0]
    assert abs(found.body[0] - PAYLOAD[0]) < 3 * found.body_std_total[0]


def test_records_that_begin_elsewhere_in_the_program_are_shifted() -> None:
    truth = draw(231, 4)
    path = wander(np.random.default_rng(1), 4)
    before = log(truth, path, 1)
    after = log(truth.with_payload(PAYLOAD), lambda time: path(time + 0.6), 2)
    after = [replace(s, spec=s.spec.model_copy(update={"pose": before[0].spec.pose})) for s in after]
    found = payload(truth.robot, before, after)
    assert np.nanmax(np.abs(off(found))) < 4
    assert found.excited[:4].all()


def test_planned_trajectories_are_motions_and_their_plan_states_the_least_std() -> None:
    truth = draw(232, 4)
    free = before_and_after(truth, 232)
    lines = {"sines": (Sine(frequency=0.1, amplitude=0.1, phase=0.0),), "period": 40.0, "periods": 1}
    before, after = ([replace(s, spec=s.spec.model_copy(update=lines)) for s in part] for part in free)
    np.testing.assert_array_equal(payload(truth.robot, before, after).body, payload(truth.robot, *free).body)
    path = np.stack([s.recording.position for s in free[0]], -1)
    once, four = (planned_mass_std(truth.robot, np.vstack(times * [path, path[::-1]]), 250.0) for times in (1, 4))
    assert four == pytest.approx(once / 2, rel=0.1)


@pytest.mark.parametrize("seed", [*range(232, 236), *UNLOADED])
def test_friction_that_changed_is_told_as_no_load(seed: int) -> None:
    """Nothing mounted: by Pinocchio with a fifth more dry friction, and by the second plant hours later."""
    if seed in UNLOADED:
        bare, later = (log_of_plant(seed, family="arm", elastic=False, payload=part) for part in (0.0, 1e-9))
        parts = [[*one.sweeps, *one.held_out] for one in (bare, later)]
        found = payload(bare.robot, parts[0], [_begun(sweep, 1000.0) for sweep in parts[1]])
    else:
        truth = draw(seed, 3 + seed % 4)
        path = wander(np.random.default_rng(seed), len(truth.robot.axes))
        later = replace(truth, viscous=0.8 * truth.viscous, coulomb=1.2 * truth.coulomb, offset=1.5 * truth.offset)
        found = payload(truth.robot, log(truth, path, seed), log(later, path, seed + 1, started_at=900.0))
    print(f"{seed}: {found.body[0]:.3g} kg, std {found.body_std[0]:.2g}, {found.body[0] / found.body_std[0]:+.1f}")
    assert any("not a load but friction" in note or "do not excite mass" in note for note in sentences(found))


def test_the_command_tells_the_payload(tmp_path: Path) -> None:
    truth = draw(234, 3)
    for name, sweeps in zip(("before", "after"), before_and_after(truth, 234), strict=True):
        write_bundle(tmp_path / name, truth.robot, sweeps)
    pair = str(tmp_path / "before"), str(tmp_path / "after")
    told = sweepid("estimate", "payload", *pair, "--json", str(tmp_path / "payload.json"))
    assert told.returncode == 0, told.stderr
    assert "Payload on link_3, in the frame of joint_3" in told.stdout
    document = json.loads((tmp_path / "payload.json").read_text())
    mass = document["mass"]
    assert mass["value"] == pytest.approx(PAYLOAD[0], abs=4 * mass["std"])
    assert np.shape(document["parameters"]["covariance"]) == (10, 10)
    assert document["physical"]["nearest"]["mass"] > 0


def test_another_program_tells_nothing() -> None:
    truth = draw(233, 3)
    before = log(truth, wander(np.random.default_rng(1), 3), 1)
    after = log(truth.with_payload(PAYLOAD), wander(np.random.default_rng(2), 3), 2)
    with pytest.raises(BadInput, match="no motion was run both before and after"):
        payload(truth.robot, before, after)


def test_one_axis_alone_does_not_excite_a_body() -> None:
    """A single vertical axis: only the inertia about it shows, and no mass."""
    scenario = scenario_named("max100-full")
    body = AddedBody(name="payload", mass=40.0, start=(0.1, 0, 0), end=(0.35, 0, 0), radius=0.1)
    loaded = scenario.model_copy(update={"links": {**scenario.links, "link_6": LinkDeviation(added=(body,))}})
    poses = np.zeros((2, 6))
    poses[:, 1] = 0.0, 0.5
    before, after = (measure_at(s, k, poses, axes=("joint_1",)) for k, s in enumerate((scenario, loaded), 1))
    found = payload(before.robot, before.sweeps, after.sweeps)
    assert not found.excited.all()
    assert not found.excited[4:].any()


def test_sweeps_tell_the_payload(tmp_path: Path) -> None:
    """Axes 1 to 3 of the virtual machine in 14 poses, 60 kg."""
    rng = np.random.default_rng(9)
    poses = np.zeros((14, 6))
    poses[:, 1], poses[:, 2] = rng.uniform(-1.0, 1.0, 14), rng.uniform(-1.8, 1.0, 14)
    poses[:, 3:] = rng.uniform(-1.2, 1.2, (14, 3))
    mass, length, radius = 60.0, 0.25, 0.14
    bar = AddedBody(name="payload", mass=mass, start=(0.1, 0, 0), end=(0.1 + length, 0, 0), radius=radius)
    across, along = mass * (3 * radius**2 + length**2) / 12, mass * radius**2 / 2
    true = body_of(KnownMass(mass, (0.1 + length / 2, 0, 0), (along, 0, across, 0, 0, across)).parameters)
    bare = scenario_named("max100-full")
    loaded = bare.model_copy(update={"links": {**bare.links, "link_6": LinkDeviation(added=(bar,))}})
    before, after = measure_at(bare, 3, poses), measure_at(loaded, 4, poses)
    for name, campaign in (("before", before), ("after", after)):
        write_bundle(tmp_path / name, campaign.robot, campaign.sweeps)
    found = payload_of(tmp_path / "before", tmp_path / "after")
    figures = [found.mass, *found.center.values(), *found.inertia.values()]
    for figure, value in zip(figures, true, strict=True):
        print(f"{figure.value} +- {figure.std}, true {value:.4f}")
        if figure.excited:
            assert figure.std is not None
            assert figure.value == pytest.approx(value, abs=4 * figure.std)
    assert found.mass.std is not None
    assert found.mass.std_total is not None
    assert found.mass.std < 2.0
    assert found.mass.std_total > found.mass.std
    assert [each.axis for each in found.evidence] == ["joint_1", "joint_2", "joint_3"]


def test_bundles_in_the_wrong_order_or_the_same_end_in_words() -> None:
    truth = draw(231, 4)
    before, after = before_and_after(truth, 231)
    assert any("exchange the bundles" in note for note in sentences(payload(truth.robot, after, before)))
    with pytest.raises(BadInput, match="no effort differs"):
        payload(truth.robot, before, before)
