"""The loop of a diagnosis by the API of a service that has a machine of the second plant: from a campaign to the end.

`--seed` draws other machines.
"""

import json
import time
from collections.abc import AsyncGenerator, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from unittest.mock import patch

import numpy as np
import pytest

import service.machine.execution.sweep_executor
import service.web.application
from drivers.ports import SampleBlock, SweepCommand
from service.diagnosis.experiments import MOST_EXPERIMENTS
from service.model import Robot, Sweep, SweepSpec
from service.model.results.diagnosis import AxisDiagnosis
from service.store.documents import BoltedMass
from service.store.files.bundle import write_bundle
from service.web.client import Json, ServiceClient
from tests.numeric.second_plant.cases import Case, make
from tests.numeric.second_plant.loop import MARGINS, OPEN, STARTS, bolted, broken, hundred, of_campaign
from tests.numeric.second_plant.plans import Plan, followed, motion
from tests.numeric.second_plant.robots import Body
from tests.system.rest_bench import until
from tests.unit.service.api.conftest import packed
from tests.unit.service.campaigns.formula_drive import FormulaDrive
from tests.unit.service.hosting import hosting

SEED, MACHINES = 79, 6
PATIENCE = 600.0  # s
NEAR = 5e-3  # rad (m), more than the tolerance of a pose


class HiddenDrive(FormulaDrive):
    """The axis of a case, whose sweeps are computed before they are asked for. What it is asked for takes no time, but
    its clock goes on as if it did.
    """

    def __init__(self, robot: Robot) -> None:
        super().__init__(robot.joints)
        self._ready: list[Sweep] = []
        self._late = 0.0  # s

    def monotonic(self) -> float:
        return time.monotonic() + self._late

    def ready(self, sweeps: Sequence[Sweep]) -> None:
        self._ready, self._late = list(sweeps), 0.0

    async def move_to(self, joint: str, position: float, velocity: float) -> None:
        self._late += abs(position - self.position[joint]) / velocity
        await super().move_to(joint, position, velocity)

    async def run_sweep(self, *commands: SweepCommand) -> AsyncGenerator[SampleBlock, None]:
        async for block in super().run_sweep(*commands):
            self.position[block.joint] = float(block.position[-1])
            yield block
        self._late += commands[0].duration

    def samples(self, command: SweepCommand) -> SampleBlock:
        wanted = (command.offset_velocity, [(one.frequency, one.amplitude, one.phase) for one in command.sines])
        here = [self.position[joint] for joint in self.joints]  # where the last sweep ended, if that is near enough
        alike = [
            (float(np.abs(np.subtract(one.spec.pose, here)).max()), k)
            for k, one in enumerate(self._ready)
            if (one.spec.offset_velocity, [(s.frequency, s.amplitude, s.phase) for s in one.spec.sines]) == wanted
        ]
        distance, number = min(alike)
        assert distance < NEAR, (command, here)
        ran, rate = self._ready.pop(number), command.sample_rate
        record, index = ran.recording, np.arange(len(ran.recording.time))
        alone = followed(Plan((), rate, window=0.0, run_out=0.0, measure_from=ran.spec.measure_from), [ran.spec])
        setpoint = motion(alone, 1 / rate).velocity[index, 0]
        return SampleBlock(
            command.joint, index, index / rate, record.effort, record.velocity, record.position, setpoint
        )


def course(one: Case, folder: Path) -> list[str]:
    """The verdicts with what was proposed then. AssertionError, ServiceProblem or BadInput if a proposal cannot be run,
    what must not be in a diagnosis is, or it does not end.
    """
    chance = np.random.default_rng((one.seed, one.number, 9))
    start = STARTS[str(chance.choice(list(STARTS)))]
    robot, joint, measured, _ = make(one, small=True)
    bare = [sweep for sweep in measured if start(sweep.spec)]
    drive, steps = HiddenDrive(robot), list[str]()
    write_bundle(folder / "bundle", robot, bare)
    (folder / "bundle.zip").write_bytes(packed(folder / "bundle"))
    with (
        _serving(folder, drive, robot, float(chance.choice(MARGINS))) as url,
        ServiceClient(url) as client,
    ):
        campaign = client.import_bundle(folder / "bundle.zip")
        found = client.diagnosed(client.add_diagnosis([campaign["id"]], [joint], start="cad")["id"])
        later: list[tuple[SweepSpec, Body | None]] = []
        for number in range(MOST_EXPERIMENTS + 1):
            assert found["state"] == "done", found["cause"]
            axis = AxisDiagnosis.read(found["document"]["axes"][joint], "")
            wanted = axis.next_experiment
            steps.append(f"{axis.verdict}: {wanted.kind if wanted else 'end'}")
            assert list(broken(axis)) == [], steps
            if axis.verdict not in OPEN or wanted is None:
                return steps
            mass = bolted(robot, joint, bare, number + 1) if wanted.weighs else None
            planned = client.plan_experiment(found["id"], joint)["document"]["sweeps"]
            specs = [SweepSpec.model_validate(one["spec"]) for one in planned]
            body = None if mass is None else Body(mass.mass, np.array(mass.center), np.zeros((3, 3)))
            later += [(of_campaign(spec, number, measured), body) for spec in specs]
            measured = make(one, small=True, later=later)[2]
            drive.ready(measured[-len(specs) :])
            found = _continued(client, found, joint, mass)
    raise AssertionError(f"it does not end: {steps}")


@contextmanager
def _serving(folder: Path, drive: HiddenDrive, robot: Robot, margin: float) -> Iterator[str]:
    """The service of a machine with this robot; yields its address."""
    robots, cells = folder / "robots", folder / "cells"
    for made in (robots, cells):
        made.mkdir()
    description = robot.description.model_copy(update={"urdf": "hidden.urdf"})
    (robots / "hidden.urdf").write_text(robot.urdf_text, "utf-8")
    (robots / "hidden.yaml").write_text(json.dumps(description.model_dump(mode="json")), "utf-8")
    (cells / "hidden.yaml").write_text(json.dumps({"name": "hidden", "joint_margin": margin}), "utf-8")
    own = {"robots_dir": str(robots), "cells_dir": str(cells), "robot": "hidden", "cell": "hidden"}
    with (
        patch.object(service.web.application, "open_profile", lambda _: ({}, drive)),
        patch.object(service.machine.execution.sweep_executor, "time", drive),
        hosting(folder, folder / "drives.yaml", lease_time=60.0, **own) as url,
    ):
        yield url


def _continued(client: ServiceClient, found: Json, joint: str, mass: BoltedMass | None) -> Json:
    """The diagnosis that follows from the experiment of this one, which is approved."""
    bolted_on = None if mass is None else mass.model_dump(mode="json")
    campaign = client.approve_experiment(found["id"], joint, "Ada", bolted_on)["id"]
    until(lambda: client.campaign(campaign)["state"] not in ("planned", "running", "pausing"), "the sweeps", PATIENCE)
    ended = client.campaign(campaign)
    assert ended["state"] in ("measured", "completed"), ended["structured_cause"]

    def following() -> list[Json]:
        return [one for one in client.diagnoses() if one["parent"] == found["id"]]

    until(following, "the next diagnosis", PATIENCE)
    return client.diagnosed(following()[0]["id"])


@pytest.mark.slow
@pytest.mark.parametrize("number", range(MACHINES))
def test_what_is_proposed_can_be_run_until_it_ends(number: int, tmp_path: Path, request: pytest.FixtureRequest) -> None:
    seed = request.config.getoption("--seed") or SEED
    every = hundred(seed)
    one = every[int(np.random.default_rng((seed, number)).integers(len(every)))]
    print(one)  # shown if it fails
    steps = course(one, tmp_path)
    print(*steps, sep=" > ")
    assert 1 <= len(steps) <= MOST_EXPERIMENTS + 1
