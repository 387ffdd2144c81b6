"""What a stored plan of any kind and version says of its robot, cell and machine, and of the times of its sweeps."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

from pydantic import BaseModel, ConfigDict

if TYPE_CHECKING:  # a client names plans without the libraries of the store
    from service.store.documents import PlanRecord


class PlanSubject(BaseModel):
    """`robot`, `cell`: their names. `machine`: the one for which the plan was made; empty: any other, or unknown.

    `confirmed`: names of a robot or cell that is not the machine's, which a person typed, by "robot" and "cell";
    `confirmed_by`: that person, if known.
    """

    model_config = ConfigDict(frozen=True)
    robot_id: int
    robot: str
    cell: str
    machine: str
    confirmed: dict[str, str]
    confirmed_by: str

    @property
    def sentence(self) -> str:
        """All of it in one line, for a person."""
        machine = self.machine or "not recorded"
        return f"robot {self.robot} (number {self.robot_id}) in cell {self.cell}, machine {machine}{self.typed}"

    @property
    def typed(self) -> str:
        """End of a sentence that says what is not the machine's; empty if all is."""
        names = " and ".join(f"{what} {name}" for what, name in self.confirmed.items())
        by = f" by {self.confirmed_by}" if self.confirmed_by else ""
        return f"; NOT the machine's, confirmed{by}: {names}" if names else ""


class MadeFor(BaseModel):
    """The machine for which a plan was made.

    `confirmed`: names of a robot or cell that is not the machine's, which a person typed; `by`: that person, if known.
    `narrowed`: limits of the drive profile that are narrower than those of the robot, which the plan keeps; "" if none.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")
    machine: str
    confirmed: dict[str, str] = {}  # by "robot" and "cell"
    by: str = ""
    narrowed: str = ""


class _StoredRequest(BaseModel):
    cell: str = ""


class _StoredSubject(BaseModel):
    """Common part of the document of any stored plan, of every version."""

    robot: str = ""
    request: _StoredRequest = _StoredRequest()
    made_for: MadeFor | None = None


def plan_subject(robot_id: int, document: object) -> PlanSubject:
    """`document`: of a stored plan of any kind."""
    found = _StoredSubject.model_validate(document)
    made_for = found.made_for or MadeFor(machine="")
    return PlanSubject(
        robot_id=robot_id,
        robot=found.robot,
        cell=found.request.cell,
        machine=made_for.machine,
        confirmed=made_for.confirmed,
        confirmed_by=made_for.by,
    )


@dataclass(frozen=True)
class PlannedTime:
    """A planned sweep: duration with the moves to it, s; its start in the plan, s; and the joints that it moves."""

    duration: float
    start: float
    joints: frozenset[str]


class _StoredLeg(BaseModel):
    joint: str


class _StoredSpec(BaseModel):
    axis: str
    started_at: float


class _StoredSweep(BaseModel):
    duration: float
    spec: _StoredSpec
    legs: tuple[_StoredLeg, ...]


class _StoredTimes(BaseModel):
    """Common part of the document of any stored plan, of every version."""

    sweeps: tuple[_StoredSweep, ...]


def planned_times(plan: "PlanRecord") -> tuple[PlannedTime, ...]:
    """The times, in the order of the sweeps."""
    return tuple(
        PlannedTime(
            sweep.duration, sweep.spec.started_at, frozenset({sweep.spec.axis, *(leg.joint for leg in sweep.legs)})
        )
        for sweep in _StoredTimes.model_validate(plan.document).sweeps
    )
