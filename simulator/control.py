"""The control port: fault injection while the virtual machine runs, JSON lines over TCP, one reply per line."""

import json
import selectors
import socket
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from math import inf
from typing import Any, Protocol, cast

from simulator.cabinet import DriveCabinet, FieldbusNode
from simulator.canopen.node import CanopenNode, ForeignNode
from simulator.drive.limits import PER_MILLE
from simulator.drive.power_drive import Glitch, OrderedFault

Request = dict[str, Any]
Reply = dict[str, object]


class BadOrder(ValueError):
    """An order that cannot be executed; the text is the reply."""


class SwitchableBus(Protocol):
    """A bus that can be switched off."""

    def switch_off(self, *, off: bool) -> None:
        """Bus-off, signalled by an error frame, or back on."""


@dataclass(frozen=True, slots=True)
class OrderTarget:
    """Target of the orders; `bus` is None if the fieldbus has no equivalent of bus-off."""

    cabinet: DriveCabinet[Any]
    bus: SwitchableBus | None


def _disturb(node: FieldbusNode, **values: object) -> None:
    for name, value in values.items():
        setattr(node.axis.disturbance, name, value)


def _fault(plant: OrderTarget, request: Request) -> None:
    node, code = _node(plant, request), _number(request, "code", 0xFFFF)
    if "at_sample" in request and "at_counter" in request:
        raise BadOrder("at_sample, at_counter: one of them at most")
    if "at_sample" in request:
        _disturb(_own(node), fault=OrderedFault(code, at_sample=_number(request, "at_sample")))
    elif "at_counter" in request:
        _disturb(_can(node), fault=OrderedFault(code, at_counter=_number(request, "at_counter")))
    else:
        node.axis.fail(code)


def _delay_tpdos(plant: OrderTarget, request: Request) -> None:
    node = _can(_node(plant, request))
    count, cycles = _number(request, "count"), _number(request, "cycles", 1000)
    _disturb(node, delay_tpdos=count, delay_cycles=cycles)


def _glitch(plant: OrderTarget, request: Request) -> None:
    node, revolutions = _node(plant, request), request.get("revolutions")
    if not isinstance(revolutions, int | float) or isinstance(revolutions, bool) or not 0 < abs(revolutions) <= 1000:
        raise BadOrder(f"revolutions: {_echo(revolutions)} is not a number up to 1000 either way, and not 0")
    at_sample = _number(request, "at_sample") if "at_sample" in request and _own(node) else None
    _disturb(node, glitch=Glitch(float(revolutions), at_sample))


def _saturate(plant: OrderTarget, request: Request) -> None:
    node = _node(plant, request)
    released = request["torque_permille"] is None
    _disturb(node, torque_cap=inf if released else _number(request, "torque_permille", 5000) / PER_MILLE)


def _swap(plant: OrderTarget, request: Request) -> None:
    one, other = _node(plant, request), _node(plant, request, "with")
    if one is other:
        raise BadOrder(f"with: {_echo(request['with'])} is the same drive")
    first, second = one.number, other.number
    one.renumber(second)
    other.renumber(first)


def _identity(plant: OrderTarget, request: Request) -> None:
    node = _node(plant, request)
    fields = {"vendor": 1, "product": 2, "revision": 3, "serial": 4}
    node.dictionary.nameplate |= {
        (0x1018, sub): _number(request, name) for name, sub in fields.items() if name in request
    }
    node.boot()


@dataclass(frozen=True, slots=True)
class Order:
    """Function that executes the order, and its required and optional fields."""

    act: Callable[[OrderTarget, Request], Reply | None]
    required: tuple[str, ...] = ()
    optional: tuple[str, ...] = ()


ORDERS = {
    "status": Order(lambda plant, _: plant.cabinet.status()),
    "fault": Order(_fault, ("joint", "code"), ("at_sample", "at_counter")),
    "emcy": Order(
        lambda plant, r: _can(_node(plant, r)).axis.errors.announce(_number(r, "code", 0xFFFF)), ("joint", "code")
    ),
    "silence": Order(lambda plant, r: _disturb(_node(plant, r), mute=_flag(r)), ("joint", "on")),
    "drop_tpdos": Order(
        lambda plant, r: _disturb(_can(_node(plant, r)), drop_tpdos=_number(r, "count")), ("joint", "count")
    ),
    "duplicate_tpdos": Order(
        lambda plant, r: _disturb(_can(_node(plant, r)), duplicate_tpdos=_number(r, "count")), ("joint", "count")
    ),
    "delay_tpdos": Order(_delay_tpdos, ("joint", "count", "cycles")),
    "freeze_counter": Order(
        lambda plant, r: _disturb(_own(_can(_node(plant, r))), counter_frozen=_flag(r)), ("joint", "on")
    ),
    "bus_off": Order(lambda plant, _: _bus(plant).switch_off(off=True)),
    "bus_on": Order(lambda plant, _: _bus(plant).switch_off(off=False)),
    "emergency_stop": Order(lambda plant, r: plant.cabinet.emergency_stop(on=_flag(r)), ("on",)),
    "limit": Order(lambda plant, r: _node(plant, r).axis.hit_limit_switch(on=_flag(r)), ("joint", "on")),
    "glitch": Order(_glitch, ("joint", "revolutions"), ("at_sample",)),
    "saturate": Order(_saturate, ("joint", "torque_permille")),
    "reboot": Order(lambda plant, r: _node(plant, r).boot(), ("joint",)),
    "swap": Order(_swap, ("joint", "with")),
    "identity": Order(_identity, ("joint",), ("vendor", "product", "revision", "serial")),
}


def carry_out(plant: OrderTarget, line: bytes) -> Reply:
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
    return {"ok": True, **(reply or {})}


def _node(plant: OrderTarget, request: Request, field: str = "joint") -> FieldbusNode:
    joint = request.get(field)
    if not isinstance(joint, str) or joint not in plant.cabinet.nodes:
        raise BadOrder(f"{field} {_echo(joint)} is not one of {', '.join(plant.cabinet.nodes)}")
    return plant.cabinet.nodes[joint]


def _can(node: FieldbusNode) -> FieldbusNode:
    if not isinstance(cast(object, node), CanopenNode):
        raise BadOrder("not on this fieldbus")
    return node


def _own(node: FieldbusNode) -> FieldbusNode:
    if isinstance(node, ForeignNode):
        raise BadOrder("not with this drive: it has neither trace nor sample counter")
    return node


def _bus(plant: OrderTarget) -> SwitchableBus:
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
    return text if len(text) <= 60 else text[:60] + "..."


class ControlServer:
    """Serves orders on `host`:`port` (0: a free one) through the owner's selector, in the owner's thread."""

    largest_line = 65536

    def __init__(
        self,
        selector: selectors.BaseSelector,
        host: str,
        port: int,
        cabinet: DriveCabinet[Any],
        bus: SwitchableBus | None = None,
    ) -> None:
        self._selector = selector
        self._plant = OrderTarget(cabinet, bus)
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
            data = client.recv(self.largest_line)
            received = self._clients[client]
            received += data
            *lines, rest = received.split(b"\n")
            self._clients[client] = bytearray(rest)
            for line in lines:
                client.sendall(json.dumps(carry_out(self._plant, bytes(line))).encode() + b"\n")
        except OSError:
            data = b""
        if not data or len(self._clients[client]) > self.largest_line:
            self._drop(client)

    def _drop(self, client: socket.socket) -> None:
        del self._clients[client]
        self._selector.unregister(client)
        client.close()
