"""The second half of the demo: a machine with a hidden effect is measured and diagnosed; then the truth is read.

The machine is of the same type, with a corrected model except for one effect that its seed selects. It tells the axis
of the effect; service and demo get no more information until the diagnosis was accepted.
"""

import json
import subprocess
from dataclasses import dataclass
from pathlib import Path

from service.cli.demo.cell import VirtualCell, virtual_cell
from service.cli.demo.operator import Operator
from service.cli.demo.processes import command, environment
from service.cli.demo.screen import Screen
from service.model.configuration import Cell
from service.model.errors import SweepidError
from service.model.results.diagnosis import AxisDiagnosis, Diagnosis, RigidParameter
from service.model.robot import Robot
from service.web.client import Json, ServiceClient

SCENARIO = Path("config/scenarios/max100-as-modelled.yaml")
REQUEST: Json = {
    "kind": "diagnosis",
    "varied": ["joint_2", "joint_3"],
    "poses": 3,
    "blocks": ["forward_slow", "wide"],  # other blocks are measured when the diagnosis proposes them
    "move_velocity": 0.5,
}
EXPERIMENTS = 2  # number that the demo runs if the diagnosis proposes more
PERSON = "operator of the demo"
SURE = 4.0  # standard deviations: exceeded by one of 20 parameters by chance in 1 of 800 diagnoses
_TIMEOUT = 120.0  # s


@dataclass(frozen=True)
class Found:
    """`document` of the last diagnosis from the API; `hidden` is the later output of `sweepid drive truth`."""

    joint: str
    document: Json
    experiments: tuple[str, ...]  # run because the diagnosis proposed them
    model: int | None  # accepted revision
    hidden: Json

    @property
    def diagnosis(self) -> Diagnosis:
        return Diagnosis.read(self.document, "diagnosis")

    @property
    def axis(self) -> AxisDiagnosis:
        return self.diagnosis.axes[self.joint]

    @property
    def named(self) -> list[str]:
        return [effect.effect for effect in self.axis.effects] if self.axis.verdict == "named" else []

    @property
    def right(self) -> bool:
        """Whether the hidden effect was named, and no other."""
        return self.named == [self.hidden["effect"]]

    @property
    def off_from_cad(self) -> RigidParameter | None:
        """The link parameter that differs most from CAD, for a hidden gravity error within the model's prior.

        A diagnosis starts with link parameters fitted within the robot's prior; only a part that exceeds this
        prior is a named effect.
        """
        if self.hidden["effect"] != "gravity_error" or self.axis.verdict != "none":
            return None
        off = [(_deviation(one), one) for one in self.axis.rigid_model if one.name != "viscous_friction"]
        deviation, found = max(off, key=lambda pair: pair[0], default=(0.0, None))
        return found if deviation >= SURE else None

    @property
    def description(self) -> str:
        """The hidden effect, in words."""
        sizes = ", ".join(f"{plain(name)} {value:.4g}" for name, value in self.hidden["parameters"].items())
        return plain(self.hidden["effect"]) + (f" ({sizes})" if sizes else "")

    @property
    def judgement(self) -> str:
        """Whether the diagnosis was correct, in a sentence."""
        if self.right:
            accepted = f"accepted as revision {self.model} of the model" if self.model else "but not accepted"
            return f"Right; {accepted}."
        if self.named:
            return f"Wrong: {', '.join(map(plain, self.named))} was named."
        if self.hidden["effect"] in self.axis.candidates:
            return "Not decided: it is among the candidates."
        if off := self.off_from_cad:
            return (
                f"Not named, but fitted: it is as small as CAD's own uncertainty. {off.name} is {off.value:.4g} "
                f"+/- {off.std:.2g}, CAD says {off.nominal:.4g}."
            )
        return f"Not found: the verdict is {self.axis.verdict}."


def _deviation(one: RigidParameter) -> float:
    """Difference from CAD, in standard deviations of the identified value."""
    return abs(one.value - one.nominal) / one.std if one.nominal is not None and one.std else 0.0


def plain(name: str) -> str:
    """A name of the diagnosis in words."""
    return name.replace("_", " ")


def find_hidden(folder: Path, robot: Robot, cell: Cell, seed: int, screen: Screen) -> Found:
    """Measure and diagnose the machine for this seed; processes and files as in `virtual_cell`."""
    folder.mkdir(exist_ok=True)
    screen.doing("starting a machine that hides something")
    with virtual_cell(folder, robot, SCENARIO, "--seed", str(seed), "--hide", str(seed)) as machine:
        joint = machine.machine.hidden_in
        diagnosis, experiments = _diagnosed(machine, joint, cell, screen)
        model = _accepted(machine.client, diagnosis, joint)
    return Found(joint, diagnosis["document"], experiments, model, _truth(seed))


def _diagnosed(machine: VirtualCell, joint: str, cell: Cell, screen: Screen) -> tuple[Json, tuple[str, ...]]:
    """The last diagnosis, and the experiments that it proposed and that were run."""
    client, operator = machine.client, Operator(machine.client, screen.progress, screen.say)
    screen.doing(f"measuring {joint} for its diagnosis")
    plan = client.add_plan(REQUEST | {"robot_id": machine.robot_id, "cell": cell.name, "axes": [joint]})
    campaign = int(client.add_campaign(plan["id"])["id"])
    operator.run(campaign)
    screen.doing("diagnosing")
    diagnosis = _done(client, client.add_diagnosis([campaign], [joint]))
    experiments: list[str] = []
    while wanted := _axis(diagnosis, joint).next_experiment:
        if wanted.weighs or not wanted.sweeps or len(experiments) == EXPERIMENTS:
            break
        experiments.append(wanted.kind)
        screen.say(f"the diagnosis asks: {wanted.reason}; approved")
        screen.doing(f"next experiment: {plain(wanted.kind)}")
        operator.watch(int(client.approve_experiment(diagnosis["id"], joint, PERSON)["id"]))
        screen.doing("diagnosing with the new sweeps")
        diagnosis = _done(client, _continued(client, diagnosis["id"]))
    return diagnosis, tuple(experiments)


def _continued(client: ServiceClient, parent: int) -> Json:
    """The diagnosis that the service started after the experiment."""
    for event in client.events():
        if event["kind"] == "diagnosis":
            found = client.diagnosis(event["data"]["diagnosis"])
            if found["parent"] == parent:
                return found
    raise SweepidError("the event stream ended before the diagnosis was done")


def _done(client: ServiceClient, diagnosis: Json) -> Json:
    found = client.diagnosed(diagnosis["id"])
    if found["state"] != "done":
        raise SweepidError(f"diagnosis {found['id']} failed: {found['cause']}")
    return found


def _axis(diagnosis: Json, joint: str) -> AxisDiagnosis:
    return Diagnosis.read(diagnosis["document"], f"diagnosis {diagnosis['id']}").axes[joint]


def _accepted(client: ServiceClient, diagnosis: Json, joint: str) -> int | None:
    """The model's revision, if there is a named effect to accept."""
    axis = _axis(diagnosis, joint)
    if axis.verdict != "named" or set(axis.rolled_back) >= {effect.effect for effect in axis.effects}:
        return None
    return int(client.accept_model(diagnosis["id"], PERSON, [joint])["revision"])


def _truth(seed: int) -> Json:
    arguments = command("drive", "truth", str(SCENARIO), "--hide", str(seed))
    answer = subprocess.run(arguments, capture_output=True, text=True, env=environment(), timeout=_TIMEOUT, check=False)
    if answer.returncode:
        raise SweepidError(f"sweepid drive truth: {answer.stderr.strip()}")
    found: Json = json.loads(answer.stdout)
    return found
