"""The tenth robot of a type: nine of the second plant were measured before, with other loads; MuJoCo has the truth."""

from dataclasses import dataclass, replace
from functools import cache

import numpy as np
import pytest

from service import BadInput
from service.identification.estimates.estimate import RobotEstimate, identify
from service.identification.estimates.robot_type import RobotType, robot_type
from service.identification.estimation import estimate_document
from service.identification.spectra.frequency_response import Spectrum, spectrum
from service.jobs.work import Job, Revisions
from service.model import Axis, Prior, Robot, RobotDescription, SweepSpec, build_robot
from service.model.configuration import Cell
from service.model.results.estimate import Estimate
from service.planning.documents import PlanDocument, PlanRequest
from service.planning.plan import build_plan
from tests.formula_sweep import Turning, by_formula
from tests.numeric.second_plant.bodies import Rigid
from tests.numeric.second_plant.robots import Body, Mechanism, block, joined, put_off, random_mechanism, urdf

AXES = ("joint_1", "joint_2", "joint_3")
HELD_BACK = range(500, 504)  # no seed of these was tuned on


@dataclass(frozen=True)
class Type:
    """The robot file of a type, and its robots as built: their links scatter by 0.3 %, their loads by 5 %."""

    robot: Robot
    mechanisms: tuple[Mechanism, ...]
    rotors: np.ndarray
    stranger: Mechanism  # CAD off by 10 to 18 % in another way

    def plan(self, earlier: RobotType | None) -> PlanDocument:
        request = PlanRequest(robot_id=1, axes=AXES, varied=AXES[1:], step=20.0, confidence=1.0)
        return build_plan(self.robot, request, Cell(name="empty"), earlier=earlier)

    def measured(self, mechanism: Mechanism, plan: PlanDocument, seed: int) -> list[Spectrum]:
        random, rigid = np.random.default_rng(seed), Rigid(mechanism)
        return [self._sweep(rigid, sweep.spec, random) for sweep in plan.sweeps]

    def _sweep(self, rigid: Rigid, spec: SweepSpec, random: np.random.Generator) -> Spectrum:
        index, pose = self.robot.index(spec.axis), np.array(spec.pose)
        axis = self.robot.axes[index]
        viscous = axis.viscous_friction or 0.0
        inertia = rigid.inertia(index, pose) + self.rotors[index]
        away = 1e-3 * np.eye(len(pose))[index]
        weight, stiffness = rigid.holding(pose)[index], (rigid.holding(pose + away) - rigid.holding(pose - away)) / 2e-3

        def effort(turning: Turning) -> np.ndarray:
            gravity = weight + stiffness[index] * (turning.position - turning.position.mean())
            friction = 0.02 * axis.rated_effort + viscous * turning.velocity
            noise = 0.0014 * axis.rated_effort * random.normal(size=len(turning.time))
            return inertia * turning.acceleration + gravity + friction + noise

        return spectrum(
            self.robot,
            by_formula(effort, spec.measure_from + (spec.periods or 0) * (spec.period or 0.0), **spec.model_dump()),
        )

    def error(self, found: RobotEstimate, mechanism: Mechanism) -> tuple[np.ndarray, np.ndarray]:
        """Of J over the workspace, relative, and in standard deviations, (axes, poses)."""
        rigid, poses = Rigid(mechanism), found.workspace[:200]
        truth = np.array([np.diag(rigid.matrix(pose)) for pose in poses]).T[:3] + self.rotors[:3, None]
        values = np.array([found.identified(joint, poses) for joint in AXES])
        stds = np.array([found.identified_std(joint, poses) for joint in AXES])
        return values / truth - 1, (values - truth) / stds


def loaded(mechanism: Mechanism, load: Body) -> Mechanism:
    return replace(mechanism, bodies=(*mechanism.bodies[:-1], joined(mechanism.bodies[-1], load)))


@cache
def drawn(seed: int) -> Type:
    random = np.random.default_rng(seed)
    while len((cad := random_mechanism(random, "arm", "arm")).joints) != 3:
        pass
    load = block(60.0, tuple(cad.flange), (0.3, 0.3, 0.3), random)
    built = put_off(loaded(cad, load), 0.10, 0.18, random)
    change = [float(1 + 0.05 * random.normal()) for _ in range(10)]
    robots = tuple(
        put_off(loaded(built, Body(60 * (factor - 1), cad.flange, load.spread * (factor - 1))), 0.003, 0.003, random)
        for factor in change
    )
    rigid = Rigid(loaded(cad, load))
    poses = random.uniform(-1.0, 1.0, (12, 3))
    inertia = np.array([np.diag(rigid.matrix(pose)) for pose in poses]).mean(axis=0)
    rated = np.round(6.0 * inertia + 1.5 * np.abs([rigid.holding(pose) for pose in poses]).max(axis=0), -1)
    motors, ratios = 0.4 * inertia, (150.0, 150.0, 150.0)
    axes = [
        Axis(
            joint=joint, gear_ratio=ratio, motor_inertia=float(motor) / ratio**2, rated_effort=float(effort),
            viscous_friction=float(0.3 * effort),
        )
        for joint, ratio, motor, effort in zip(cad.names, ratios, motors, rated, strict=True)
    ]  # fmt: skip
    prior = Prior(inertia=0.3, gravity=0.3, viscous_friction=0.5, motor_inertia=0.1, effort_gain=0.0)
    robot = build_robot(
        RobotDescription(name="arm", urdf="robot.urdf", axes=tuple(axes), prior=prior), urdf(loaded(cad, load))
    )
    return Type(robot, robots, 1.05 * motors, put_off(loaded(cad, load), 0.10, 0.18, random))


@cache
def earlier(seed: int, stranger: bool = False) -> dict[str, Estimate]:
    """Nine robots by a plan for 1 % without a prior; with the stranger, it is one of them."""
    of = drawn(seed)
    plan = of.plan(None)
    mechanisms = [*of.mechanisms[:8], of.stranger if stranger else of.mechanisms[8]]
    return {
        f"robot {k}": estimate_document(of.robot, of.measured(one, plan, 100 * seed + k))
        for k, one in enumerate(mechanisms)
    }


@pytest.mark.parametrize("stranger", [False, True])
def test_the_tenth_robot_needs_a_third_of_the_sweeps(stranger: bool) -> None:
    errors: list[float] = []
    z: list[np.ndarray] = []
    for seed in HELD_BACK:
        of = drawn(seed)
        known = robot_type(of.robot, earlier(seed, stranger))
        assert [one.name for one in known.members if not one.belongs] == (["robot 8"] if stranger else [])
        before, plan = of.plan(None), of.plan(known)
        assert len(plan.sweeps) <= len(before.sweeps) / 3
        found = identify(of.robot, of.measured(of.mechanisms[9], plan, 100 * seed + 50), earlier=known)
        assert found.prior is not None
        assert found.prior.used
        error, own = of.error(found, of.mechanisms[9])
        print(f"seed {seed}: {len(plan.sweeps)} sweeps for 1 %, {len(before.sweeps)} without the others")
        errors.append(float(np.percentile(np.abs(error), 95)))
        z.append(own)
    print(f"J over the workspace off by {100 * np.array(errors)} % (95th percentile); std of z {np.std(z):.2f}")
    print(f"within two {100 * np.mean(np.abs(z) < 2):.1f} %")
    assert np.median(errors) < 0.01
    # 12 independent values (axes of robots): of 95 % ten or more are within two, with a probability of 98 %
    assert np.mean(np.abs(z) < 2) > 0.8


def test_a_robot_of_another_type_gets_no_prior() -> None:
    of = drawn(1)
    known = robot_type(of.robot, earlier(1))
    sweeps = of.measured(of.stranger, of.plan(None), 7)
    found = identify(of.robot, sweeps, earlier=known)
    assert found.prior is not None
    assert not found.prior.used
    assert np.array_equal(found.solution.values, identify(of.robot, sweeps).solution.values)


def test_what_is_no_type() -> None:
    of, known = drawn(1), earlier(1)
    some = {name: known[name] for name in ("robot 0", "robot 1", "robot 3")}
    with pytest.raises(BadInput, match="prior: 3 earlier robots; the scatter of a type needs 4 or more"):
        robot_type(of.robot, some)
    unknown = known["robot 2"].base_parameters[0].model_copy(update={"std": None})
    open_one = known["robot 2"].model_copy(update={"base_parameters": (unknown, *known["robot 2"].base_parameters[1:])})
    with pytest.raises(BadInput, match=r"robot 2: does not determine Izz\(link_1\).*more poses"):
        robot_type(of.robot, some | {"robot 2": open_one})
    fewer = known["robot 2"].model_copy(update={"base_parameters": known["robot 2"].base_parameters[:-1]})
    with pytest.raises(BadInput, match=r"robot 2: its base parameters .* are not those of the first"):
        robot_type(of.robot, some | {"robot 2": fewer})


def test_a_campaign_that_names_them_has_them_as_its_prior() -> None:
    of, known = drawn(1), earlier(1)
    job = Job("", of.robot.description, of.robot.urdf_text, sweeps=(), earlier=(), analyses={}, siblings=known)
    found = Estimate.read(Revisions().next(job, of.robot, of.measured(of.mechanisms[9], of.plan(None), 3)), "estimate")
    assert found.prior is not None
    assert [one.name for one in found.prior.members] == list(known)
    assert "Prior: 9 earlier robots of the type" in " ".join(part for part in found.shown() if isinstance(part, str))
