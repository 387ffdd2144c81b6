"""The machine's drives: what they are, how they stand, and what a person may do about it without moving anything."""

from collections.abc import Mapping

from fastapi import APIRouter
from pydantic import BaseModel

from drivers.ports import AxisIdentity, AxisState, AxisStatus, SweepMode
from service.api.dependencies import LabOf
from service.api.idempotent import IdempotentRoute
from service.campaigns.machine import Machine
from service.errors import NotFound

router = APIRouter(prefix="/drives", tags=["drives"], route_class=IdempotentRoute)


class FaultView(BaseModel):
    """A pending fault; `code` is the CiA 402 error code (603Fh) or the maker's."""

    code: int
    text: str
    emergency_stop: bool


class IdentityView(BaseModel):
    """What the device says of itself (CiA 301 object 1018h)."""

    address: str
    vendor: int
    product: int
    revision: int
    serial: int
    dictionary_sha256: str


class AxisView(BaseModel):
    """One axis: position rad (m), velocity rad/s (m/s), effort N m (N); null where there is no word from the drive."""

    joint: str
    state: AxisState
    position: float | None
    velocity: float | None
    effort: float | None
    fault: FaultView | None
    identity: IdentityView | None


class DrivesView(BaseModel):
    """The machine; `trouble` says why it is not connected."""

    connected: bool
    trouble: str
    sweep_modes: tuple[SweepMode, ...]
    axes: tuple[AxisView, ...]


@router.get("")
async def get_drives(lab: LabOf) -> DrivesView:
    """State, position, faults and identity of every axis."""
    machine = lab.machine
    status: Mapping[str, AxisStatus] = await machine.status() if machine.connected else {}
    identities = {identity.joint: identity for identity in machine.identities}
    modes = machine.capabilities.sweep_modes if machine.connected else frozenset[SweepMode]()
    return DrivesView(
        connected=machine.connected,
        trouble=machine.trouble,
        sweep_modes=tuple(sorted(modes, key=lambda mode: mode.value)),
        axes=tuple(_axis(joint, status.get(joint), identities.get(joint)) for joint in machine.joints),
    )


@router.post("/connect")
async def connect(lab: LabOf) -> DrivesView:
    """Connect, or connect again after a loss. Every axis is disabled afterwards."""
    await lab.machine.connect()
    return await get_drives(lab)


@router.post("/{joint}/acknowledge")
async def acknowledge(joint: str, lab: LabOf) -> AxisView:
    """Clear the fault of one axis after a person looked. The axis stays without energy."""
    machine = lab.machine
    _check_joint(machine, joint)
    await machine.acknowledge(joint)
    status = await machine.status()
    identity = next((identity for identity in machine.identities if identity.joint == joint), None)
    return _axis(joint, status.get(joint), identity)


def _check_joint(machine: Machine, joint: str) -> None:
    if joint not in machine.joints:
        raise NotFound(f"drive {joint}: the machine has {', '.join(machine.joints)}")


def _axis(joint: str, status: AxisStatus | None, identity: AxisIdentity | None) -> AxisView:
    known = None if identity is None else IdentityView.model_validate(identity, from_attributes=True)
    if status is None:
        return AxisView(
            joint=joint,
            state=AxisState.UNKNOWN,
            position=None,
            velocity=None,
            effort=None,
            fault=None,
            identity=known,
        )
    return AxisView(
        joint=joint,
        state=status.state,
        position=status.position,
        velocity=status.velocity,
        effort=status.effort,
        fault=None if status.fault is None else FaultView.model_validate(status.fault, from_attributes=True),
        identity=known,
    )
