"""The loop of a diagnosis on machines of the second plant: what it proposes is planned, run and diagnosed, to the end.

    python -m tests.numeric.second_plant.loop --seed 1 --processes 2 --json loop.json

A person mounts the test mass, and a heavier one each time that it is asked for again. Every second cell leaves an axis
so little room that fast sweeps do not fit everywhere.
"""

import argparse
import json
import multiprocessing
from collections import Counter
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass, field
from functools import partial
from pathlib import Path

import numpy as np

from service import BadInput
from service.diagnosis.diagnose import diagnose_axis
from service.diagnosis.document import axis_document
from service.diagnosis.experiments import MOST_EXPERIMENTS
from service.diagnosis.fit.calibration import Weighed
from service.identification.design.diagnosis_sweeps import DesignedSweep
from service.identification.estimates.torque_gain import KnownMass
from service.identification.model import gravity_terms
from service.model import Robot, Sweep, SweepSpec
from service.model.configuration import Cell
from service.model.results.diagnosis import AxisDiagnosis, DiagnosedModel, Diagnosis, Experiment
from service.planning.diagnosis import ExperimentPlace, build_experiment_plan
from service.planning.documents import ExperimentRequest
from service.store.documents import BoltedMass
from tests.numeric.second_plant.cases import Case, cases, make
from tests.numeric.second_plant.robots import Body

MARGINS = (0.02, 0.25)  # rad (m) from every limit: a cell with much room, and one with little
OPEN = ("ambiguous", "unknown", "untestable")
STARTS = {  # what was measured before the loop: the whole design, both directions slow, what the paper measures
    "full": lambda spec: True,
    "slow": lambda spec: spec.block in ("forward_slow", "backward_slow"),
    "paper": lambda spec: (spec.block, spec.repeat) == ("forward_slow", 0),
}


@dataclass
class Course:
    """What came of a machine: the verdicts with what was proposed then, how it ended, and what must not be."""

    case: Case
    start: str
    steps: list[str] = field(default_factory=list)
    end: str = ""
    broken: list[str] = field(default_factory=list)
    grown: list[str] = field(default_factory=list)  # candidates that an experiment brought


def hundred(seed: int) -> list[Case]:
    """Every effect in every size, pairs, effects outside the catalogue, and healthy machines."""
    return cases(seed, singles=1, none=16, pairs=17, outside=16, sizes=("small", "medium", "large"))


def course(one: Case) -> Course:
    """The loop of one machine; what was measured first and the room in its cell are drawn by its number."""
    chance = np.random.default_rng((one.seed, one.number, 9))
    told = Course(one, str(chance.choice(list(STARTS))))
    robot, joint, measured, _ = make(one, small=True)
    cell = Cell(name="hidden", joint_margin=float(chance.choice(MARGINS)))
    place = ExperimentPlace(ExperimentRequest(robot_id=1), cell, ())
    sweeps, weighed = [sweep for sweep in measured if STARTS[told.start](sweep.spec)], None
    later: list[tuple[SweepSpec, Body | None]] = []
    asked: list[tuple[object, ...]] = []
    before: AxisDiagnosis | None = None
    for number in range(MOST_EXPERIMENTS + 1):
        found = diagnose_axis(
            robot, joint, sweeps, weighed=weighed, twin=False, experiments=number,
            runnable=partial(place.runnable, robot),
        )  # fmt: skip
        axis = axis_document(found)
        wanted = axis.next_experiment
        told.steps.append(f"{axis.verdict} {', '.join(axis.candidates)}: {wanted.kind if wanted else 'end'}")
        told.broken += broken(axis)
        told.grown += sorted(set(axis.candidates) - set(before.candidates)) if before and before.candidates else []
        if axis.verdict not in OPEN or wanted is None:
            told.end = f"{axis.verdict}, cannot" if axis.verdict in OPEN else axis.verdict
            return told
        mass = bolted(robot, joint, sweeps, 1 if weighed is None else 2) if wanted.weighs else None
        what = (wanted.kind, mass, *((s.spec.pose, s.spec.offset_velocity, s.spec.sines) for s in wanted.sweeps))
        told.broken += [f"{wanted.kind} is proposed again"] if what in asked else []
        asked.append(what)
        try:
            specs = _planned(robot, wanted, cell, mass)
        except BadInput as error:
            told.broken.append(f"{wanted.kind} cannot be run: {error}")
            return told
        body = None if mass is None else Body(mass.mass, np.array(mass.center), np.zeros((3, 3)))
        later += [(of_campaign(spec, number, measured), body) for spec in specs]
        measured = make(one, small=True, later=later)[2]
        new = measured[-len(specs) :]
        sweeps += new if mass is None else ()
        weighed = weighed if mass is None else Weighed(KnownMass(**mass.model_dump()), new)
        before = axis
    told.broken.append("it does not end")
    return told


def broken(axis: AxisDiagnosis) -> Iterator[str]:
    """What must not be in any diagnosis."""
    if axis.verdict == "none" and not axis.has_noise_floor:
        yield "none, without a noise floor"
    if axis.verdict == "named" and not (axis.gap.cross_validated or axis.gap.held_out_sweeps):
        yield "named, and no sweep was held out"
    if (
        axis.verdict in OPEN
        and axis.next_experiment is None
        and "cannot be diagnosed further, because" not in axis.summary
    ):
        yield f"{axis.verdict}, no experiment and no reason: {axis.summary}"
    shown = Diagnosis(axes={"axis": axis}, model=DiagnosedModel(robot="hidden", effects={})).shown()
    for line in (line for part in shown if isinstance(part, str) for line in part.splitlines()):
        name, _, words = line.partition(" = ")
        given, _, left = words.partition(" ± ")  # the formula of a law has none
        value, std = (float(given), float(left.split()[0])) if left else (1.0, 0.0)
        if std > abs(value) / 1.9:  # of rounded figures
            yield f"{name.strip()} is not significant: {words}"


def _planned(robot: Robot, wanted: Experiment, cell: Cell, mass: BoltedMass | None) -> list[SweepSpec]:
    """The sweeps of the product's plan; BadInput if there are none."""
    designed = [DesignedSweep(sweep.spec, sweep.ramp, sweep.settle) for sweep in wanted.sweeps]
    plan = build_experiment_plan(robot, ExperimentRequest(robot_id=1, test_mass=mass), designed, cell)
    return [sweep.spec for sweep in plan.sweeps]


def of_campaign(spec: SweepSpec, number: int, before: Sequence[Sweep]) -> SweepSpec:
    """The sweep of a campaign that starts five minutes after those `before`, as the service names it among them."""
    visits = {(sweep.spec.block, sweep.spec.pose) for sweep in before}
    again = f" of campaign {number}" if (spec.block, spec.pose) in visits else ""
    start = max(sweep.spec.started_at for sweep in before) + 300.0
    change = {"id": f"{number}/{spec.id}", "started_at": spec.started_at + start, "block": spec.block + again}
    return spec.model_copy(update=change)


def bolted(robot: Robot, joint: str, sweeps: Sequence[Sweep], times: int) -> BoltedMass:
    """A mass beside the last link that pulls with a tenth of the rated effort; from 5 to 80 kg, or so many `times`."""
    last = robot.chain.inertial[-1]
    place = (float(last[1] / last[0]) + 0.1, float(last[2] / last[0]) + 0.05, float(last[3] / last[0]))
    links = np.zeros(robot.chain.inertial.size)
    links[-10:] = KnownMass(1.0, place).parameters
    poses = np.array([sweep.spec.pose for sweep in sweeps])
    pull = np.abs(gravity_terms(robot.chain, links, robot.gravity, robot.index(joint), poses)[:, 0]).max()
    mass = 0.1 * robot.axis(joint).rated_effort / max(float(pull), 1e-9)
    return BoltedMass(mass=min(max(mass, 5.0), 80.0) * times, center=place)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--json", type=Path, help="every course as a file")
    given = parser.parse_args()
    every: list[Course] = []
    with ProcessPoolExecutor(given.processes, mp_context=multiprocessing.get_context("spawn")) as pool:
        for one in pool.map(course, hundred(given.seed)):
            every.append(one)
            told = "; ".join((*one.broken, *(f"grown: {name}" for name in one.grown)))
            names = "+".join(one.case.names) or "none"
            print(f"{one.case.number} {names} {one.start} | {' > '.join(one.steps)} | {told}", flush=True)
    print(Counter(one.end or "broken" for one in every), "experiments", Counter(len(one.steps) - 1 for one in every))
    if given.json:
        given.json.write_text(json.dumps([asdict(one) for one in every], default=str))


if __name__ == "__main__":
    main()
