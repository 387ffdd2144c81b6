"""From evidence to diagnoses, experiment after experiment. Nothing here sees a truth: none is among the arguments."""

import time
from typing import Any

from service.diagnosis.diagnose import diagnose_axis
from service.diagnosis.document import axis_document
from service.diagnosis.experiments import TEST_MASS
from service.diagnosis.fit.calibration import Weighed
from simulator.scenario import AddedBody
from tests.numeric.blind.cases import Evidence
from tests.numeric.blind.machine import known_mass

ROUNDS = 5  # diagnoses at most
BAR = 0.2  # of the rated effort over g and a metre: a mass that is seen well


def diagnosed(evidence: Evidence, rounds: int = ROUNDS, *, twin: bool = False) -> list[dict[str, Any]]:
    """One axis as in `sweepid diagnose --json` after each experiment, with the seconds of a processor it took."""
    sweeps, weighed, documents = list(evidence.sweeps), None, list[dict[str, Any]]()
    while True:
        before = time.process_time()
        found = diagnose_axis(evidence.robot, evidence.joint, sweeps, weighed=weighed, twin=twin)
        documents.append(axis_document(found) | {"seconds": time.process_time() - before})
        wanted = found.next_experiment
        if wanted is None or not wanted.sweeps or len(documents) == rounds:
            return documents
        if wanted.kind == TEST_MASS:
            bar = _bar(evidence)
            weighed = Weighed(known_mass(bar), evidence.measure(wanted.sweeps, bar))
        else:
            sweeps += evidence.measure(wanted.sweeps, None)


def _bar(evidence: Evidence) -> AddedBody:
    """What an operator bolts on."""
    mass = BAR * evidence.robot.axis(evidence.joint).rated_effort / 9.81
    return AddedBody(name="test mass", mass=mass, start=(0.05, 0.0, 0.0), end=(0.25, 0.0, 0.0), radius=0.1)
