"""The statement of the machine's state as it is served."""

from typing import Self

from pydantic import BaseModel, ConfigDict

from service.machine.execution.statement import Condition, Statement


class AxisStatementView(BaseModel):
    """As `StatementView`, of one axis."""

    model_config = ConfigDict(from_attributes=True)
    state: Condition
    age: float | None
    reason: str


class StatementView(BaseModel):
    """`state`: `moves`, `unknown`, `energised` (standstill with energy) or `stands` (standstill without energy).

    By what the drives report; a report older than 2 s says nothing: `unknown`, with the `reason`. The machine is in
    the first of these states in which one of its axes is. `age`: s since the drives were asked; null: they never
    answered.
    """

    state: Condition
    age: float | None
    reason: str
    axes: dict[str, AxisStatementView]

    @classmethod
    def of(cls, statement: Statement) -> Self:
        return cls.model_validate(statement, from_attributes=True)
