"""The plant itself: against Pinocchio, MuJoCo's own step, energy, and numbers by hand."""

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from numpy.typing import NDArray

from tests.numeric.second_plant.bodies import Curve, Rigid
from tests.numeric.second_plant.build import Wanted, build
from tests.numeric.second_plant.free import run_free
from tests.numeric.second_plant.friction import Bristle, Now, Sliders
from tests.numeric.second_plant.laws import Hose, Waves
from tests.numeric.second_plant.machine import STEP, Controls, Raw, Spring, Train, run
from tests.numeric.second_plant.plans import Motion
from tests.numeric.second_plant.robots import FAMILIES, put_off, random_mechanism, urdf
from tests.numeric.second_plant.sensors import Sensors, sample

Array = NDArray[np.float64]

NO_CONTROLS = Controls(0.0, 0.0, 0.0, 1.0, 0.0, 1e9)  # what is fed forward is the torque
QUIET = Sensors(0.0, 0.0, 100.0, 0.0, 1e-8, 0.0, 0.0, 0.0)


@pytest.mark.parametrize("family", FAMILIES)
def test_inertia_and_weight_are_pinocchios(family: str) -> None:
    random = np.random.default_rng(4)
    cad = random_mechanism(random, "robot", family)
    for mechanism in (cad, put_off(cad, 0.10, 0.18, random)):
        model = pin.buildModelFromXML(urdf(mechanism))
        data, rigid = model.createData(), Rigid(mechanism)
        for pose in random.uniform(-0.5, 0.5, (5, len(mechanism.joints))):
            whole = pin.crba(model, data, pose)
            weight = pin.computeGeneralizedGravity(model, data, pose)
            np.testing.assert_allclose(rigid.matrix(pose), whole, rtol=1e-6, atol=1e-6)
            np.testing.assert_allclose(rigid.holding(pose), weight, rtol=1e-6, atol=1e-5)


def test_stepping_is_mujocos() -> None:
    """Closed loop with all joints free: a tenth of a per cent of the torque that moves the axis, or better."""
    random = np.random.default_rng(11)
    while True:
        scene = build(random, Wanted((), "none", small=True), "robot")
        if scene.draft.built.joints[scene.draft.index].kind == "revolute" and scene.draft.weight() > 100:
            break
    draft, some = scene.draft, [6, 12]  # fast, wide
    short = round(1.5 / STEP)
    wanted = Motion(*(part[:short, some] for part in (
        draft.wanted.velocity, draft.wanted.acceleration, draft.wanted.position,
    )))  # fmt: skip
    train = draft.train
    train.load, train.gravity = train.load[some], replace(
        train.gravity, start=train.gravity.start[some], values=train.gravity.values[some]
    )  # fmt: skip
    train.viscous_motor, train.viscous_load = train.viscous_motor[some], train.viscous_load[some]
    ours = run(train, scene.controls, draft.starts[some], wanted, np.zeros((short, len(some))))
    theirs = run_free(
        draft.built, draft.index, draft.motor, draft.viscous, scene.controls, draft.plan.poses[some], wanted
    )
    moving = np.abs(theirs.torque - theirs.torque[0]).max(axis=0)
    assert (np.abs(ours.torque - theirs.torque).max(axis=0) < 2e-3 * moving).all()
    assert (np.abs(ours.velocity - theirs.velocity).max(axis=0) < 2e-3 * np.abs(theirs.velocity).max(axis=0)).all()


def test_energy_goes_where_it_should() -> None:
    """Work of the drive = kinetic + potential energy + what viscous and dry friction took, over two seconds."""
    level, viscous = np.array([40.0]), np.array([300.0])
    train = _train(load=150.0, motor=50.0, viscous=viscous, slope=900.0)
    train.dry = [Bristle(lambda now: level, 2e-6, np.zeros(1))]
    time = np.arange(8000) * STEP
    ramp = np.clip(time / 0.3, 0, 1)
    velocity = (ramp * (0.1 + 0.02 * np.sin(2 * np.pi * 3 * time)))[:, None]
    controls = Controls(200.0 * 100, 15.0, 2.0, 200.0, 300.0, 1e5)
    raw = run(train, controls, np.zeros(1), _motion(velocity), np.zeros_like(velocity))
    v, q, u = raw.velocity[:, 0], raw.position[:, 0], raw.torque[:, 0]
    work = np.trapezoid(u * v, dx=STEP)
    kept = 0.5 * 200.0 * (v[-1] ** 2 - v[0] ** 2) + 0.5 * 900.0 * (q[-1] ** 2 - q[0] ** 2)
    taken = np.trapezoid(viscous[0] * v**2 + level[0] * np.abs(v), dx=STEP)
    assert work == pytest.approx(kept + taken, rel=2e-3)


@pytest.mark.parametrize("kind", ["bristle", "sliders"])
def test_friction_sticks_until_its_level_is_reached(kind: str) -> None:
    """A torque that creeps up to 98 % of the level moves nothing but the bristle; what comes above moves the axis."""
    level, reach, inertia = np.array([80.0]), 2e-6, 200.0
    train = _train(load=150.0, motor=50.0)
    train.dry = [
        Bristle(lambda now: level, reach, np.zeros(1))
        if kind == "bristle"
        else Sliders(lambda now: level, np.array([[reach], [2 * reach]]), np.array([[0.5], [0.5]]), np.zeros((2, 1)))
    ]
    torque = np.interp(np.arange(16000) * STEP, [0.0, 3.0, 3.5, 4.0], [0.0, 0.98 * 80.0, 0.98 * 80.0, 1.3 * 80.0])
    raw = run(train, NO_CONTROLS, np.zeros(1), _torque(torque), np.zeros((16000, 1)))
    stuck = slice(0, round(3.5 / STEP))
    assert np.abs(raw.velocity[stuck]).max() < 1e-4
    assert raw.position[stuck][-1, 0] < 10 * reach
    slides = (0.3 * 80.0 / inertia) * 0.5**2 / 6  # the surplus grows with time: x = a t^2 / 6
    assert raw.position[-1, 0] == pytest.approx(slides, rel=0.15)


@pytest.mark.parametrize("velocity", [1e-7, 1e-3, 0.2])
def test_a_bristle_is_dahls_equation_solved(velocity: float) -> None:
    """Against fine steps of dy/dt = v / z (1 - y): exact however far a step goes."""
    now = Now(STEP, 0.0, *(np.zeros(1) for _ in range(5)))
    one = Bristle(lambda now: np.ones(1), 2e-6, np.array([-0.5]))
    share, fine = -0.5, STEP / 4000
    for _ in range(4000):
        share += fine * velocity / 2e-6 * (1 - share)
    force, stiff = one.opposes(now, np.array([velocity]))
    further, _ = one.opposes(now, np.array([velocity * 1.0001]))
    one.moved(now, np.array([velocity]))
    assert force[0] == pytest.approx(share, rel=2e-2)
    assert one.share[0] == pytest.approx(force[0], rel=1e-12)
    assert stiff[0] == pytest.approx((further - force)[0] / (velocity * 1e-4), rel=1e-2, abs=1e-6)


def test_two_masses_swing_at_their_frequency() -> None:
    """Free: w^2 = k (1 / J + 1 / Jm), no energy lost in ten seconds."""
    load, motor, stiffness = 120.0, 60.0, 2e5
    train = _train(load=load, motor=motor)
    train.spring = Spring(np.array([stiffness]), np.zeros(1))
    kick = np.zeros(40000)
    kick[:40] = 500.0
    raw = run(train, NO_CONTROLS, np.zeros(1), _torque(kick), np.zeros((40000, 1)))
    twist = (raw.position - raw.load_position)[100:, 0]
    rises = np.flatnonzero((twist[:-1] < 0) & (twist[1:] >= 0))
    frequency = (len(rises) - 1) / ((rises[-1] - rises[0]) * STEP)
    assert frequency == pytest.approx(np.sqrt(stiffness * (1 / load + 1 / motor)) / (2 * np.pi), rel=1e-3)
    assert np.ptp(twist[-4000:]) == pytest.approx(np.ptp(twist[:4000]), rel=1e-3)


@pytest.mark.parametrize("spring", [None, Spring(np.array([2e5]), np.array([100.0]))])
def test_an_axis_that_is_held_stands(spring: Spring | None) -> None:
    """A spring carries weight and hose at the start, and not what acts on the motor: nothing swings."""
    train = _train(load=150.0, motor=50.0, slope=900.0)
    train.spring = spring
    orders, sizes, phases = (np.array([[a], [b]]) for a, b in ((1.0, 2.0), (80.0, 40.0), (0.3, 1.0)))
    train.on_motor = [Waves(100.0, orders, sizes, phases, 0.3, 500.0)]
    train.on_load = [Hose(300.0, 0.1, np.inf, 5.0)]
    controls = Controls(200.0 * 100, 15.0, 2.0, 200.0, 0.0, 1e5)
    raw = run(train, controls, np.array([0.3]), _motion(np.zeros((4000, 1))), np.zeros((4000, 1)))
    assert np.ptp(raw.position) < 1e-9
    assert np.ptp(raw.load_position) < 1e-9


def test_torque_and_motion_are_of_one_instant() -> None:
    """J dv/dt at the samples is the torque told there: no part of a step between them."""
    raw, _ = _shaken()
    acceleration = np.gradient(raw.velocity[:, 0], STEP)
    middle = slice(400, -400)
    assert _lag(raw.torque[middle, 0], 200.0 * acceleration[middle]) == pytest.approx(0.0, abs=1e-7)


@pytest.mark.parametrize("late", [0.31e-3, 1.7e-3])
def test_a_torque_is_told_as_late_as_given(late: float) -> None:
    raw, _ = _shaken()
    told = sample(replace(QUIET, effort_delay=late, single=False), raw, 2000.0, np.random.default_rng(1))
    true = sample(replace(QUIET, single=False), raw, 2000.0, np.random.default_rng(1))
    middle = slice(300, -300)
    assert _lag(told.effort[middle, 0], true.effort[middle, 0], 1 / 2000.0) == pytest.approx(late, rel=1e-2)


def _train(load: float, motor: float, viscous: Array | None = None, slope: float = 0.0) -> Train:
    """One sweep about 0 against a torque `slope` times the position."""
    grid = np.linspace(-1.0, 1.0, 2001)
    zero = np.zeros(1)
    curve = Curve(np.array([-1.0]), 1e-3, slope * grid[None])
    return Train(motor, np.array([load]), zero if viscous is None else viscous, zero, curve)


def _motion(velocity: Array) -> Motion:
    return Motion(velocity, np.gradient(velocity, STEP, axis=0), np.cumsum(velocity, axis=0) * STEP)


def _torque(torque: Array) -> Motion:
    column = torque[:, None]
    return Motion(np.zeros_like(column), column, np.zeros_like(column))


def _shaken() -> tuple[Raw, Array]:
    """A free mass of 200 kg m^2 under 7 Hz."""
    torque = 300.0 * np.sin(2 * np.pi * 7 * np.arange(12000) * STEP)
    return run(_train(150.0, 50.0), NO_CONTROLS, np.zeros(1), _torque(torque), np.zeros((12000, 1))), torque


def _lag(late: Array, early: Array, step: float = STEP) -> float:
    """By how much a sine of 7 Hz comes later, s."""
    turn = np.exp(-2j * np.pi * 7 * step * np.arange(len(late)))
    whole = turn[: len(turn) - len(turn) % round(1 / (7 * step)) or None]
    a, b = (float(np.angle((column[: len(whole)] * whole).sum())) for column in (late, early))
    return (b - a) / (2 * np.pi * 7)
