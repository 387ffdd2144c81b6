"""The parts of a service that owns a machine; a service without one (`--no-machine`) only reads data of the plant."""

import asyncio
from dataclasses import dataclass

from service.jobs.diagnosing import Diagnosing
from service.jobs.experiments import Experiments
from service.jobs.jobs import Batches, Checking, Jobs
from service.jobs.recording_uploads import RecordingUploads
from service.machine.execution.machine import Machine
from service.machine.execution.permission import Approvals
from service.machine.execution.runner import Runner
from service.machine.execution.statement import Condition
from service.machine.execution.sweep_executor import SweepExecutor
from service.machine.stop_process.handle import StopProcess
from service.planning.machine_setup import MachineSetup
from service.publishing.publisher import Publisher
from service.store.files.recordings import RecordingFiles
from service.store.rows import NoMachine


@dataclass(frozen=True)
class Cell:
    """The machine of a service, and the parts that move it or compute from its recordings."""

    setup: MachineSetup
    lost: str
    """Reason why nothing may be stored: the database does not belong to the data folder; empty if it does."""
    machine: Machine
    jobs: Jobs
    executor: SweepExecutor
    runner: Runner
    approvals: Approvals
    diagnosing: Diagnosing
    experiments: Experiments
    checking: Checking
    batches: Batches
    moving: RecordingUploads | None  # None: recordings stay in the data folder
    publisher: Publisher | None  # None: neither OPC UA nor MQTT
    stop_process: StopProcess | None

    def _unknown(self) -> str:
        statement = self.machine.statement
        unknown = self.machine.connected and statement.state is Condition.UNKNOWN
        return f"the state of the machine is unknown: {statement.reason}" if unknown else ""

    async def troubles(self, files: RecordingFiles, least_free_disk: int) -> tuple[str, ...]:
        """Reasons why no measurement or identification is possible now; "" for each part that works."""
        process = self.stop_process
        await self.machine.ask()
        return (
            self.lost,
            "" if self.machine.connected else f"machine not connected: {self.machine.trouble or 'not tried yet'}",
            self._unknown(),
            self.machine.forbidden,
            "" if process is None else process.failed,
            await asyncio.to_thread(files.disk_trouble, least_free_disk),
            self.runner.unstored,
            *self.jobs.troubles,
            *self.checking.troubles,
            *self.diagnosing.troubles,
            *self.batches.troubles,
        )


class WithCell:
    """Gives the parts of the cell by name. NoMachine if there is none and the caller requires one."""

    cell: Cell | None

    @property
    def own(self) -> Cell:
        if self.cell is None:
            raise NoMachine
        return self.cell

    @property
    def machine(self) -> Machine:
        return self.own.machine

    @property
    def runner(self) -> Runner:
        return self.own.runner

    @property
    def jobs(self) -> Jobs:
        return self.own.jobs

    @property
    def approvals(self) -> Approvals:
        return self.own.approvals

    @property
    def diagnosing(self) -> Diagnosing:
        return self.own.diagnosing

    @property
    def experiments(self) -> Experiments:
        return self.own.experiments
