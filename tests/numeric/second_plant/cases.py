"""Cases: what is hidden where, by seed; how one becomes a bundle, and its truth, which never lies beside it."""

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from enum import Enum
from typing import Any

import numpy as np
from numpy.typing import NDArray

from service.model import Recording, Robot, Sweep, SweepSpec
from tests.numeric.second_plant.bodies import Rigid
from tests.numeric.second_plant.build import Scene, Wanted, build
from tests.numeric.second_plant.draft import Draft
from tests.numeric.second_plant.effects import CATALOGUE
from tests.numeric.second_plant.faults import FAULTS, Neighbour, broken
from tests.numeric.second_plant.machine import STEP, run
from tests.numeric.second_plant.outside import OUTSIDE
from tests.numeric.second_plant.plans import spec_end
from tests.numeric.second_plant.robots import Body
from tests.numeric.second_plant.sensors import counted, noise, sample

Array = NDArray[np.float64]

SIZES = ("medium", "large")
ALL_SIZES = ("small", *SIZES)
MATES = ("coulomb_friction", "stribeck_friction", "hose_spring", "measurement_delay", "cogging_torque",
         "transmission_error", "effort_offset", "nonlinear_viscous_friction", "joint_elasticity",
         "asymmetric_friction", "friction_temperature_drift")  # fmt: skip
RIVALS = (
    {"coulomb_friction", "stribeck_friction", "asymmetric_friction", "presliding_hysteresis", "load_dependent_friction",
     "friction_temperature_drift"},  # each brings a dry level of its own
    {"joint_elasticity", "backlash"},
    {"gravity_error", "payload", "torque_constant_error"},
)  # fmt: skip


class Kind(Enum):
    """What sort of case it is."""

    NONE = "none"
    SINGLE = "single"
    PAIR = "pair"
    TRIPLE = "triple"
    OUTSIDE = "outside"
    NOMINAL = "nominal"


@dataclass(frozen=True)
class Case:
    """What is hidden; `seed` and `number` decide the rest."""

    seed: int
    number: int
    kind: Kind
    names: tuple[str, ...] = ()
    size: str = "medium"


@dataclass(frozen=True)
class Truth:
    """For the scorer alone. `hidden`: effect -> parameters; `fault`: what is wrong with nominals or data, else ""."""

    number: int
    seed: int
    kind: str
    size: str
    axis: str
    hidden: dict[str, dict[str, Any]]
    companions: tuple[str, ...]
    fault: str
    prior: str
    cad_off_by: float
    viscous_true: float
    motor_inertia_true: float  # kg m^2 on the motor side
    J_true: tuple[float, ...]  # of load and motor on the joint side, kg m^2 (kg), a value a sweep
    noise_floor: float  # N m (N)
    rated_effort: float
    records_end_with_window: bool
    sample_rate: float

    def document(self) -> dict[str, Any]:
        told = asdict(self)
        return told | {"class": told.pop("kind")}


def case(seed: int, number: int, kind: Kind, names: Sequence[str] = (), size: str = "medium") -> Case:
    """One case; every name must be one of its kind's."""
    known = {Kind.OUTSIDE: tuple(OUTSIDE), Kind.NOMINAL: FAULTS}.get(kind, tuple(CATALOGUE))
    unknown = set(names) - set(known)
    if unknown:
        raise ValueError(f"case {number}: {sorted(unknown)} are not of the kind {kind.value}: {', '.join(known)}")
    return Case(seed, number, kind, tuple(names), size)


def cases(
    seed: int,
    *,
    singles: int = 0,
    none: int = 0,
    pairs: int = 0,
    triples: int = 0,
    outside: int = 0,
    nominal: int = 0,
    balanced: int = 0,
    sizes: Sequence[str] = SIZES,
) -> list[Case]:
    """`singles` of every effect in every size; the others in all. A case's number, and so what it hides, depends on its
    kind and its place there alone: more of one kind leave the others as they were. `balanced`: healthy machines with a
    counterbalance, which their robot file has.
    """
    random = np.random.default_rng((seed, 7))
    one = [
        Case(seed, 10_000 * (1 + ALL_SIZES.index(size)) + 100 * k + n, Kind.SINGLE, (name,), size)
        for k, name in enumerate(CATALOGUE)
        for size in sizes
        for n in range(singles)
    ]
    healthy = [Case(seed, 1000 + n, Kind.NONE, (), "none") for n in range(none)]
    healthy += [Case(seed, 2000 + n, Kind.NONE, ("counterbalance",), "none") for n in range(balanced)]
    some = [Case(seed, 50_000 + n, Kind.PAIR, _together(random, 2), SIZES[n % 2]) for n in range(pairs)]
    random = np.random.default_rng((seed, 8))
    more = [Case(seed, 60_000 + n, Kind.TRIPLE, _together(random, 3), SIZES[n % 2]) for n in range(triples)]
    strange, wrong = tuple(OUTSIDE), FAULTS
    beyond = [
        Case(seed, 70_000 + n, Kind.OUTSIDE, (strange[n % len(strange)],), SIZES[n // len(strange) % 2])
        for n in range(outside)
    ]
    faulty = [Case(seed, 80_000 + n, Kind.NOMINAL, (wrong[n % len(wrong)],), "medium") for n in range(nominal)]
    return [*healthy, *one, *some, *more, *beyond, *faulty]


def make(
    one: Case,
    *,
    small: bool = False,
    bare: bool = False,
    later: Sequence[tuple[SweepSpec, Body | None]] = (),
    change: Callable[[Draft], None] | None = None,
    load_encoder: bool = False,
) -> tuple[Robot, str, tuple[Sweep, ...], Truth]:
    """Robot as on paper, joint, sweeps, and the truth. `small`: three poses and 42 sweeps; `bare`: nothing hidden.

    `later`: sweeps that the same machine runs afterwards, each with what is bolted to its flange by then; their records
    follow the others, whose noise is another one with them. `change`: of the machine before it runs. `load_encoder`:
    the records have the position of the load, from an encoder as good as the motor's.
    """
    random, records = np.random.default_rng((one.seed, one.number)).spawn(2)
    of = one.kind
    wanted = Wanted(one.names, one.size, of is Kind.OUTSIDE, of is Kind.NOMINAL, small, bare, tuple(later))
    scene = build(random, wanted, f"plant-{one.number:05}")
    draft, plan = scene.draft, scene.draft.plan
    if change is not None:
        change(draft)
    feedback = records.normal(scale=2e-6, size=draft.wanted.velocity.shape)
    raw = run(draft.train, scene.controls, plan.poses[:, draft.index], draft.wanted, feedback)
    told = sample(draft.sensors, replace(raw, torque=_told(draft.after, raw.torque, raw.position)), plan.rate, records)
    rows = [
        round((spec_end(spec) if k >= draft.drawn else plan.duration) * plan.rate) for k, spec in enumerate(plan.specs)
    ]
    stride = round(1.0 / (plan.rate * STEP))
    load = counted(draft.sensors, raw.load_position, records)[::stride] if load_encoder else None
    setpoints = draft.wanted.velocity[::stride]
    sweeps = [
        Sweep(
            spec,
            Recording(
                time=told.time[: rows[k], k], effort=told.effort[: rows[k], k], velocity=told.velocity[: rows[k], k],
                position=told.position[: rows[k], k],
                velocity_setpoint=setpoints[: rows[k], k] if scene.setpoint else None,
                load_position=None if load is None else load[: rows[k], k],
            ),
        )
        for k, spec in enumerate(plan.specs)
    ]  # fmt: skip
    robot, joint = scene.robot, scene.joint
    fault = one.names[0] if one.kind is Kind.NOMINAL else ""
    if fault and not bare:
        robot, joint, sweeps = broken(fault, robot, joint, sweeps, _neighbour(scene, rows[0], records), records)
    truth = Truth(
        one.number, one.seed, one.kind.value, one.size, joint,
        {name: hidden.parameters for name, hidden in scene.hidden.items()},
        tuple(sorted({c for hidden in scene.hidden.values() for c in hidden.companions} - set(scene.hidden))),
        "" if bare else fault, "tight" if draft.tight else "wide", scene.off_by, draft.viscous,
        draft.motor / draft.ratio**2, tuple((draft.train.load + draft.motor).tolist()), draft.sensors.floor,
        draft.rated, plan.run_out == 0.0, plan.rate,
    )  # fmt: skip
    return robot, joint, tuple(sweeps), truth


def _neighbour(scene: Scene, rows: int, random: np.random.Generator) -> Neighbour:
    """The next axis (the one before of the last) holds its weight and what the moving one throws at it."""
    draft = scene.draft
    other = draft.index + (1 if draft.index + 1 < len(draft.built.joints) else -1)
    rigid, stride = Rigid(draft.built), round(1.0 / (draft.plan.rate * STEP))
    thrown = draft.wanted.acceleration[::stride][:rows]
    shaken = noise(draft.sensors, thrown.shape, draft.plan.rate, random)
    efforts = [
        rigid.holding(pose)[other] + rigid.matrix(pose)[other, draft.index] * thrown[:, k] + shaken[:, k]
        for k, pose in enumerate(draft.plan.poses)
    ]
    return Neighbour(draft.built.names[other], [effort.astype(np.float32).astype(float) for effort in efforts])


def _told(after: Sequence[Any], torque: Array, position: Array) -> Array:
    for change in after:
        torque = change(torque, position)
    return torque


def _together(random: np.random.Generator, count: int) -> tuple[str, ...]:
    """Effects of which no two bring the same thing."""
    while True:
        names = tuple(str(name) for name in random.choice(MATES, count, replace=False))
        if all(len(rivals & set(names)) <= 1 for rivals in RIVALS):
            return names
