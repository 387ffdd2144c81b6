"""The machine's drives: identity, state, and the commands of a person that move nothing."""

from collections.abc import Mapping
from dataclasses import asdict
from typing import Any, Self

from fastapi import APIRouter
from pydantic import BaseModel, ConfigDict

from drivers.errors import Cause
from drivers.ports import AxisIdentity, AxisState, AxisStatus, Capabilities, SweepMode
from service import NotFound
from service.machine.execution.machine import Machine
from service.machine.execution.statement import NO_MACHINE, Condition, Statement
from service.store.access import Role
from service.store.plant import MachineDocument
from service.store.table_rows import NoMachine
from service.web.api.dependencies import ApplicationOf, IdempotentRoute, MachineOf
from service.web.api.problem import Problem
from service.web.api.route_roles import allow

drive_routes = APIRouter(prefix="/drives", tags=["drives"], route_class=IdempotentRoute)
machine_routes = APIRouter(prefix="/machines", tags=["drives"], route_class=IdempotentRoute)


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


_SILENT: Mapping[str, object] = {"state": AxisState.UNKNOWN} | dict.fromkeys(
    ("position", "velocity", "effort", "fault")
)
_NO_ANSWER: dict[int | str, dict[str, Any]] = {503: {"model": Problem, "description": "the drives do not answer"}}


class FaultView(BaseModel):
    """A pending fault; `code` is the CiA 402 error code (603Fh) or the manufacturer's code."""

    code: int
    text: str
    emergency_stop: bool


class IdentityView(BaseModel):
    """Identity object of the device (CiA 301 object 1018h)."""

    address: str
    vendor: int
    product: int
    revision: int
    serial: int
    dictionary_sha256: str


class AxisView(BaseModel):
    """One axis: position rad (m), velocity rad/s (m/s), effort N m (N); null if the drive does not answer."""

    joint: str
    state: AxisState
    position: float | None
    velocity: float | None
    effort: float | None
    fault: FaultView | None
    identity: IdentityView | None


class CapabilitiesView(BaseModel):
    """Capabilities of the drives. Only the service monitors a limit that is not set in the drive.

    `bus_load`: for one, two, ... axes at the same time, the largest share of `bus_bitrate` (bit/s) of a streamed sweep.
    Empty if the bit rate is not known or the fieldbus has none. A load above 0.7 is refused.
    """

    sweep_modes: tuple[SweepMode, ...]
    load_encoder: bool
    velocity_limit_in_drive: bool
    effort_limit_in_drive: bool
    position_limits_in_drive: bool
    host_watchdog_in_drive: bool
    set_point_timing: str
    simultaneous_axes: int
    hears_other_hosts: bool
    set_points: str
    bus_bitrate: int | None
    bus_load: tuple[float, ...]


class DrivesView(BaseModel):
    """The machine. `connected`: its bus is open and every drive answers. `trouble`, `trouble_cause`: why not.

    `held`: why nothing may move although it is connected: stops, the host watch, the lease. `epoch`: as of `GET /stop`.
    `capabilities`: known while its bus is open. `statement`: the state of the machine.
    """

    connected: bool
    trouble: str
    trouble_cause: Cause | None = None
    held: str
    epoch: str
    capabilities: CapabilitiesView | None
    axes: tuple[AxisView, ...]
    statement: StatementView


@drive_routes.get("")
@allow(Role.VIEWER)
async def get_drives(application: ApplicationOf) -> DrivesView:
    """State, position, faults and identity of every axis. `trouble` also reports a service without a machine."""
    if application.cell is None:
        why = str(NoMachine())
        view = StatementView.of(NO_MACHINE)
        return DrivesView(connected=False, trouble=why, held=why, epoch="", capabilities=None, axes=(), statement=view)
    machine = application.machine
    status: Mapping[str, AxisStatus] = await machine.recent_status() if machine.connected else {}
    identities = {identity.joint: identity for identity in machine.identities}
    return DrivesView(
        connected=machine.answers,
        trouble=machine.silence,
        trouble_cause=machine.silence_cause,
        held=machine.forbidden,
        epoch=machine.epochs.now,
        capabilities=_capabilities(machine.capabilities) if machine.connected else None,
        axes=tuple(_axis(joint, status.get(joint), identities.get(joint)) for joint in machine.joints),
        statement=StatementView.of(machine.statement),
    )


@drive_routes.post("/connect", responses=_NO_ANSWER)
@allow(Role.OPERATOR)
async def connect(application: ApplicationOf) -> DrivesView:
    """Connect, or reconnect after a loss. Every axis is disabled afterwards."""
    await application.machine.connect()
    return await get_drives(application)


@drive_routes.post("/{joint}/acknowledge", responses=_NO_ANSWER)
@allow(Role.OPERATOR)
async def acknowledge(joint: str, machine: MachineOf) -> AxisView:
    """Clear the fault of one axis after a person has checked it. The axis stays without energy."""
    _check_joint(machine, joint)
    await machine.acknowledge(joint)
    status = await machine.status()
    identity = next((identity for identity in machine.identities if identity.joint == joint), None)
    return _axis(joint, status.get(joint), identity)


def _check_joint(machine: Machine, joint: str) -> None:
    if joint not in machine.joints:
        raise NotFound(f"unknown drive {joint}; the machine has {', '.join(machine.joints)}")


def _capabilities(can: Capabilities) -> CapabilitiesView:
    modes = sorted(can.sweep_modes, key=lambda mode: mode.value)
    return CapabilitiesView.model_validate(asdict(can) | {"sweep_modes": modes})


def _axis(joint: str, status: AxisStatus | None, identity: AxisIdentity | None) -> AxisView:
    read = _SILENT if status is None else {name: getattr(status, name) for name in _SILENT}
    return AxisView.model_validate({"joint": joint, "identity": identity, **read}, from_attributes=True)


class Machines(BaseModel):
    """`missing`: what to set so that the machine of this service has its robot and its cell; empty: nothing."""

    items: tuple[MachineDocument, ...]
    missing: tuple[str, ...]


@machine_routes.get("")
@allow(Role.VIEWER)
def list_machines(application: ApplicationOf) -> Machines:
    """A service plans for the robot and the cell of its own machine (`here`), unless a person confirms others."""
    missing = () if application.cell is None else application.cell.setup.missing
    return Machines(items=application.plant.machines(), missing=missing)
