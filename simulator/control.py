"""The control port: fault injection while the virtual machine runs, JSON lines over TCP, one reply per line."""

import json
import selectors
import socket
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from math import inf
from typing import Any, Protocol, cast

from simulator.cabinet import Cabinet, Node
from simulator.canopen.node import Node as CanNode
from simulator.drive.disturbance import Glitch, OrderedFault
from simulator.drive.units import PER_MILLE
from simulator.foreign.cabinet import ForeignCabinet
from simulator.foreign.node import ForeignNode

Request = dict[str, Any]
Reply = dict[str, object]
AnyCabinet = Cabinet[Any] | ForeignCabinet

_LONGEST_ECHO = 60  # characters of a wrong value in a reply


class BadOrder(ValueError):
    """An order that cannot be executed; the text is the reply."""


class Bus(Protocol):
    """A bus that can be switched off."""

    def switch_off(self, *, off: bool) -> None:
        """Bus-off, signalled by an error frame, or back on."""


@dataclass(frozen=True, slots=True)
class Plant:
    """Target of the orders; `bus` is None if the fieldbus has no equivalent of bus-off."""

    cabinet: AnyCabinet
    bus: Bus | None


def _status(plant: Plant, _: Request) -> Reply:
    return plant.cabinet.status()


def _fault(plant: Plant, request: Request) -> Reply:
    node, code = _node(plant, request), _number(request, "code", 0xFFFF)
    if "at_sample" in request and "at_counter" in request:
        raise BadOrder("at_sample, at_counter: one of them at most")
    if "at_sample" in request:
        _own(node).axis.disturbance.fault = OrderedFault(code, at_sample=_number(request, "at_sample"))
    elif "at_counter" in request:
        _can(node).disturbance.fault = OrderedFault(code, at_counter=_number(request, "at_counter"))
    else:
        node.axis.fail(code)
    return {}


def _emergency_message(plant: Plant, request: Request) -> Reply:
    _can(_node(plant, request)).axis.errors.announce(_number(request, "code", 0xFFFF))
    return {}


def _silence(plant: Plant, request: Request) -> Reply:
    _node(plant, request).axis.disturbance.mute = _flag(request)
    return {}


def _drop_tpdos(plant: Plant, request: Request) -> Reply:
    _can(_node(plant, request)).disturbance.drop_tpdos = _number(request, "count")
    return {}


def _duplicate_tpdos(plant: Plant, request: Request) -> Reply:
    _can(_node(plant, request)).disturbance.duplicate_tpdos = _number(request, "count")
    return {}


def _delay_tpdos(plant: Plant, request: Request) -> Reply:
    disturbance = _can(_node(plant, request)).disturbance
    count, cycles = _number(request, "count"), _number(request, "cycles", 1000)
    disturbance.delay_tpdos, disturbance.delay_cycles = count, cycles
    return {}


def _freeze_counter(plant: Plant, request: Request) -> Reply:
    _own(_can(_node(plant, request))).axis.disturbance.counter_frozen = _flag(request)
    return {}


def _bus_off(plant: Plant, _: Request) -> Reply:
    _bus(plant).switch_off(off=True)
    return {}


def _bus_on(plant: Plant, _: Request) -> Reply:
    _bus(plant).switch_off(off=False)
    return {}


def _emergency_stop(plant: Plant, request: Request) -> Reply:
    plant.cabinet.emergency_stop(on=_flag(request))
    return {}


def _limit(plant: Plant, request: Request) -> Reply:
    _node(plant, request).axis.hit_limit_switch(on=_flag(request))
    return {}


def _glitch(plant: Plant, request: Request) -> Reply:
    node, revolutions = _node(plant, request), request.get("revolutions")
    if not isinstance(revolutions, int | float) or isinstance(revolutions, bool) or not 0 < abs(revolutions) <= 1000:
        raise BadOrder(f"revolutions: {_echo(revolutions)} is not a number up to 1000 either way, and not 0")
    at_sample = _number(request, "at_sample") if "at_sample" in request and _own(node) else None
    node.axis.disturbance.glitch = Glitch(float(revolutions), at_sample)
    return {}


def _saturate(plant: Plant, request: Request) -> Reply:
    node = _node(plant, request)
    released = request["torque_permille"] is None
    node.axis.disturbance.torque_cap = inf if released else _number(request, "torque_permille", 5000) / PER_MILLE
    return {}


def _reboot(plant: Plant, request: Request) -> Reply:
    _node(plant, request).boot()
    return {}


def _swap(plant: Plant, request: Request) -> Reply:
    one, other = _node(plant, request), _node(plant, request, "with")
    if one is other:
        raise BadOrder(f"with: {_echo(request['with'])} is the same drive")
    first, second = one.number, other.number
    one.renumber(second)
    other.renumber(first)
    return {}


def _identity(plant: Plant, request: Request) -> Reply:
    node = _node(plant, request)
    fields = {"vendor": 1, "product": 2, "revision": 3, "serial": 4}
    values = {(0x1018, sub): _number(request, name) for name, sub in fields.items() if name in request}
    node.dictionary.nameplate |= values
    node.boot()
    return {}


@dataclass(frozen=True, slots=True)
class Order:
    """Function that executes the order, and its required and optional fields."""

    act: Callable[[Plant, Request], Reply]
    required: tuple[str, ...] = ()
    optional: tuple[str, ...] = ()


ORDERS = {
    "status": Order(_status),
    "fault": Order(_fault, ("joint", "code"), ("at_sample", "at_counter")),
    "emcy": Order(_emergency_message, ("joint", "code")),
    "silence": Order(_silence, ("joint", "on")),
    "drop_tpdos": Order(_drop_tpdos, ("joint", "count")),
    "duplicate_tpdos": Order(_duplicate_tpdos, ("joint", "count")),
    "delay_tpdos": Order(_delay_tpdos, ("joint", "count", "cycles")),
    "freeze_counter": Order(_freeze_counter, ("joint", "on")),
    "bus_off": Order(_bus_off),
    "bus_on": Order(_bus_on),
    "emergency_stop": Order(_emergency_stop, ("on",)),
    "limit": Order(_limit, ("joint", "on")),
    "glitch": Order(_glitch, ("joint", "revolutions"), ("at_sample",)),
    "saturate": Order(_saturate, ("joint", "torque_permille")),
    "reboot": Order(_reboot, ("joint",)),
    "swap": Order(_swap, ("joint", "with")),
    "identity": Order(_identity, ("joint",), ("vendor", "product", "revision", "serial")),
}


def carry_out(plant: Plant, line: bytes) -> Reply:
    """Executes one request line and returns its reply. Does not raise for any input of a client."""
    try:
        request = json.loads(line)
        if not isinstance(request, dict):
            raise BadOrder("an order is a JSON object")
        request = cast(Request, request)
        name = request.get("order")
        if not isinstance(name, str) or name not in ORDERS:
            raise BadOrder(f"order {_echo(name)} is not one of {', '.join(ORDERS)}")
        order = ORDERS[name]
        for field in order.required:
            if field not in request:
                raise BadOrder(f"{field}: missing in the order {name}")
        for field in request:
            if field not in ("order", *order.required, *order.optional):
                raise BadOrder(f"{_echo(field)} is no field of the order {name}")
        reply = order.act(plant, request)
    except (ValueError, RecursionError) as error:
        return {"ok": False, "error": str(error)}
    plant.cabinet.switch()
    return {"ok": True, **reply}


def _node(plant: Plant, request: Request, field: str = "joint") -> Node | ForeignNode:
    joint = request.get(field)
    if not isinstance(joint, str) or joint not in plant.cabinet.nodes:
        raise BadOrder(f"{field} {_echo(joint)} is not one of {', '.join(plant.cabinet.nodes)}")
    return plant.cabinet.nodes[joint]


def _can(node: Node | ForeignNode) -> CanNode | ForeignNode:
    if not isinstance(node, CanNode | ForeignNode):
        raise BadOrder("not on this fieldbus")
    return node


def _own(node: Node | ForeignNode) -> Node:
    if isinstance(node, ForeignNode):
        raise BadOrder("not with this drive: it has neither trace nor sample counter")
    return node


def _bus(plant: Plant) -> Bus:
    if plant.bus is None:
        raise BadOrder("not on this fieldbus")
    return plant.bus


def _number(request: Request, field: str, highest: int = 0xFFFFFFFF) -> int:
    value = request.get(field)
    if not isinstance(value, int) or isinstance(value, bool) or not 0 <= value <= highest:
        raise BadOrder(f"{field}: {_echo(value)} is not a whole number from 0 to {highest}")
    return value


def _flag(request: Request) -> bool:
    value = request.get("on")
    if not isinstance(value, bool):
        raise BadOrder(f"on: {_echo(value)} is neither true nor false")
    return value


def _echo(value: object) -> str:
    """Value sent by the client, shortened for a reply."""
    text = repr(value)
    return text if len(text) <= _LONGEST_ECHO else text[:_LONGEST_ECHO] + "..."


_LARGEST_LINE = 65536


class ControlServer:
    """Serves orders on `host`:`port` (0: a free one) through the owner's selector, in the owner's thread."""

    def __init__(
        self, selector: selectors.BaseSelector, host: str, port: int, cabinet: AnyCabinet, bus: Bus | None = None
    ) -> None:
        self._selector = selector
        self._plant = Plant(cabinet, bus)
        self._clients: dict[socket.socket, bytearray] = {}
        self._listener = socket.create_server((host, port))
        self._listener.setblocking(False)
        self.port: int = self._listener.getsockname()[1]
        selector.register(self._listener, selectors.EVENT_READ, self._accept)

    def close(self) -> None:
        """Disconnect every client and close the port."""
        for client in list(self._clients):
            self._drop(client)
        self._selector.unregister(self._listener)
        self._listener.close()

    def _accept(self, _: int) -> None:
        client, _address = self._listener.accept()
        client.settimeout(1.0)  # for replies; data is read only when available
        self._clients[client] = bytearray()
        self._selector.register(client, selectors.EVENT_READ, partial(self._serve, client))

    def _serve(self, client: socket.socket, _: int) -> None:
        try:
            data = client.recv(_LARGEST_LINE)
            received = self._clients[client]
            received += data
            *lines, rest = received.split(b"\n")
            self._clients[client] = bytearray(rest)
            for line in lines:
                client.sendall(json.dumps(carry_out(self._plant, bytes(line))).encode() + b"\n")
        except OSError:
            data = b""
        if not data or len(self._clients[client]) > _LARGEST_LINE:
            self._drop(client)

    def _drop(self, client: socket.socket) -> None:
        del self._clients[client]
        self._selector.unregister(client)
        client.close()
