"""Times of the sweeps of a stored plan."""

from dataclasses import dataclass

from pydantic import BaseModel

from service.store.documents import PlanRecord


@dataclass(frozen=True)
class PlannedTime:
    """A planned sweep: duration with the moves to it, s; its start in the plan, s; and the joints that it moves."""

    duration: float
    start: float
    joints: frozenset[str]


class _Leg(BaseModel):
    joint: str


class _Spec(BaseModel):
    axis: str
    started_at: float


class _Sweep(BaseModel):
    duration: float
    spec: _Spec
    legs: tuple[_Leg, ...]


class _Times(BaseModel):
    """Common part of the document of any stored plan, of every version."""

    sweeps: tuple[_Sweep, ...]


def planned_times(plan: PlanRecord) -> tuple[PlannedTime, ...]:
    """The times, in the order of the sweeps."""
    return tuple(
        PlannedTime(
            sweep.duration,
            sweep.spec.started_at,
            frozenset({sweep.spec.axis, *(leg.joint for leg in sweep.legs)}),
        )
        for sweep in _Times.model_validate(plan.document).sweeps
    )
