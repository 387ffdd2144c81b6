"""From evidence to diagnoses, experiment after experiment. Nothing here can see a truth: it is not among the arguments.

A test mass gives the torque gain as it does in the service: a gain that is not one is the torque constant's error, and
one that may be one leaves what else pulls.
"""

import time
from collections.abc import Sequence
from typing import Any

from service.diagnosis.diagnose import diagnose_axis
from service.diagnosis.document import axis_document
from service.diagnosis.experiments import TEST_MASS
from service.identification import spectrum
from service.identification.nominal_priors import TorqueGain
from service.identification.torque_gain import torque_gains
from service.recording import Sweep
from simulator.scenario import AddedBody
from tests.numeric.blind.cases import Evidence
from tests.numeric.blind.effects import BY_TEST_MASS
from tests.numeric.blind.machine import known_mass

ROUNDS = 4  # diagnoses at most
CERTAIN = 3.0  # standard deviations of a gain that is not one
BAR = 0.2  # of the rated effort over g and a metre: a mass that is seen well
CALIBRATING = ("forward_slow", "backward_slow")


def diagnosed(evidence: Evidence, rounds: int = ROUNDS) -> list[dict[str, Any]]:
    """One axis as in `sweepid diagnose --json` after each experiment, with the seconds it took to find."""
    sweeps, documents, calibrated = list(evidence.sweeps), list[dict[str, Any]](), False
    while True:
        before = time.monotonic()
        found = diagnose_axis(evidence.robot, evidence.joint, sweeps, gain_calibrated=calibrated)
        documents.append(axis_document(found) | {"seconds": time.monotonic() - before})
        wanted = found.next_experiment
        if wanted is None or len(documents) == rounds:
            return documents
        if wanted.kind == TEST_MASS:
            gain = _calibrated(evidence, sweeps)
            if abs(gain.gain - 1) > CERTAIN * gain.std:
                return [*documents, _with_gain(documents[-1], gain)]
            calibrated = True
        elif wanted.sweeps:
            sweeps += evidence.measure(wanted.sweeps, None)
        else:
            return documents


def _calibrated(evidence: Evidence, sweeps: Sequence[Sweep]) -> TorqueGain:
    """The torque gain of the axis by a bar on the flange."""
    robot, joint = evidence.robot, evidence.joint
    designs = [design for design in evidence.designs if design.spec.block in CALIBRATING]
    mass = BAR * robot.axis(joint).rated_effort / 9.81
    bar = AddedBody(name="test mass", mass=mass, start=(0.05, 0.0, 0.0), end=(0.25, 0.0, 0.0), radius=0.1)
    loaded = evidence.measure(designs, bar)
    bare = [spectrum(robot, sweep) for sweep in sweeps if sweep.spec.block in CALIBRATING]
    weighed = [spectrum(robot, sweep) for sweep in loaded]
    return torque_gains(robot, bare, weighed, known_mass(bar))[joint].gain


def _with_gain(document: dict[str, Any], gain: TorqueGain) -> dict[str, Any]:
    """What was found, the torque constant's error in the place of what only a mass tells from it."""
    others = [effect for effect in document["effects"] if effect["effect"] not in BY_TEST_MASS]
    parameters = {"gain_error": {"value": gain.gain - 1, "std": gain.std, "unit": ""}}
    effects = [*others, {"effect": "torque_constant_error", "parameters": parameters, "evidence": {}}]
    return document | {"verdict": "named", "effects": effects, "candidates": [], "next_experiment": None}
