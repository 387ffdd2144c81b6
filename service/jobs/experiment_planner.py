"""Plans the experiment of a diagnosis: before it is proposed, to know that it can be run, and when it is wanted."""

from collections.abc import Mapping
from dataclasses import dataclass

from service.identification.design.diagnosis_sweeps import DesignedSweep
from service.model.configuration import read_cell
from service.model.errors import BadInput
from service.model.results.diagnosis import Experiment
from service.planning.diagnosis import build_experiment_plan
from service.planning.documents import ExperimentPlan, ExperimentRequest
from service.planning.machine_setup import MachineSetup, NeedsConfirmation, on_machine
from service.process.settings import Settings
from service.store.documents import BoltedMass
from service.store.store import Store


@dataclass(frozen=True)
class ExperimentPlanner:
    """Plans for the machine `setup`. Methods block."""

    settings: Settings
    store: Store
    setup: MachineSetup

    def plan(
        self,
        robot_id: int,
        experiment: Experiment,
        cell: str | None,
        typed: Mapping[str, str | None],
        by: str,
        test_mass: BoltedMass | None = None,
    ) -> ExperimentPlan:
        """BadInput if none of its sweeps can be run.

        `cell`: None means that of the machine. `typed`, `by`: as in `MachineSetup.confirmed`. `test_mass`: its weight
        adds effort.
        """
        designed = [DesignedSweep(sweep.spec, sweep.ramp, sweep.settle) for sweep in experiment.sweeps]
        origin, name = self.store.robot(robot_id), self.setup.own_cell(cell)
        made_for = self.setup.confirmed(origin, name, typed, by)
        request = ExperimentRequest(robot_id=robot_id, cell=name, test_mass=test_mass)
        robot = on_machine(origin.build(), self.setup.axes)
        plan = build_experiment_plan(robot, request, designed, read_cell(self.settings.cells_dir / f"{name}.yaml"))
        return plan.model_copy(update={"made_for": made_for})

    def refusal(self, robot_id: int, experiment: Experiment) -> str:
        """Why the machine cannot run the experiment, or "": also if only a person can tell its robot or cell."""
        if self.setup.cell is None:
            return ""
        try:
            self.plan(robot_id, experiment, None, {}, "")
        except NeedsConfirmation:
            return ""
        except BadInput as error:
            return str(error)
        return ""
