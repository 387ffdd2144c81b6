"""Faults to order while the virtual machine runs: JSON lines over TCP, one reply a line."""

import json
import selectors
import socket
from collections.abc import Callable
from functools import partial
from typing import Any, cast

from simulator.canopen.cabinet import Cabinet
from simulator.canopen.node import Node

Request = dict[str, Any]
Reply = dict[str, object]

_LARGEST_LINE = 65536


class BadOrder(ValueError):
    """An order that cannot be carried out; the text is the reply."""


def _fault(cabinet: Cabinet, request: Request) -> Reply:
    disturbance = _node(cabinet, request).disturbance
    disturbance.fault_at_sample = _number(request, "at_sample") if "at_sample" in request else None
    disturbance.fault_at_counter = _number(request, "at_counter") if "at_counter" in request else None
    disturbance.fault_code = _number(request, "code", 0xFFFF)
    return {}


def _silence(cabinet: Cabinet, request: Request) -> Reply:
    _node(cabinet, request).disturbance.mute = _flag(request)
    return {}


def _drop_tpdos(cabinet: Cabinet, request: Request) -> Reply:
    _node(cabinet, request).disturbance.drop_tpdos = _number(request, "count")
    return {}


def _freeze_counter(cabinet: Cabinet, request: Request) -> Reply:
    _node(cabinet, request).disturbance.counter_frozen = _flag(request)
    return {}


def _emergency_stop(cabinet: Cabinet, request: Request) -> Reply:
    cabinet.emergency_stop(on=_flag(request))
    return {}


def _identity(cabinet: Cabinet, request: Request) -> Reply:
    node = _node(cabinet, request)
    fields = {"vendor": 1, "product": 2, "revision": 3, "serial": 4}
    node.set_identity({sub: _number(request, name) for name, sub in fields.items() if name in request})
    node.boot()
    return {}


def _status(cabinet: Cabinet, _: Request) -> Reply:
    return cabinet.status()


ORDERS: dict[str, Callable[[Cabinet, Request], Reply]] = {
    "status": _status,
    "fault": _fault,
    "silence": _silence,
    "drop_tpdos": _drop_tpdos,
    "freeze_counter": _freeze_counter,
    "emergency_stop": _emergency_stop,
    "identity": _identity,
}


def carry_out(cabinet: Cabinet, line: bytes) -> Reply:
    """One request line to its reply; never raises for anything a client may send."""
    try:
        request = json.loads(line)
        if not isinstance(request, dict):
            raise BadOrder("an order is a JSON object")
        request = cast(Request, request)
        name = request.get("order")
        if not isinstance(name, str) or name not in ORDERS:
            raise BadOrder(f"order {name!r} is none of {', '.join(ORDERS)}")
        return {"ok": True, **ORDERS[name](cabinet, request)}
    except ValueError as error:
        return {"ok": False, "error": str(error)}


class ControlServer:
    """Serves orders on `host`:`port` (0: a free one) through the owner's selector, in the owner's thread."""

    def __init__(self, selector: selectors.BaseSelector, host: str, port: int, cabinet: Cabinet) -> None:
        self._selector = selector
        self._cabinet = cabinet
        self._clients: dict[socket.socket, bytearray] = {}
        self._listener = socket.create_server((host, port))
        self._listener.setblocking(False)
        self.port: int = self._listener.getsockname()[1]
        selector.register(self._listener, selectors.EVENT_READ, self._accept)

    def close(self) -> None:
        """Drop every client and the port."""
        for client in list(self._clients):
            self._drop(client)
        self._selector.unregister(self._listener)
        self._listener.close()

    def _accept(self, _: int) -> None:
        client, _address = self._listener.accept()
        client.settimeout(1.0)  # for replies; reading happens only when there is something
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
                client.sendall(json.dumps(carry_out(self._cabinet, bytes(line))).encode() + b"\n")
        except OSError:
            data = b""
        if not data or len(self._clients[client]) > _LARGEST_LINE:
            self._drop(client)

    def _drop(self, client: socket.socket) -> None:
        del self._clients[client]
        self._selector.unregister(client)
        client.close()


def _node(cabinet: Cabinet, request: Request) -> Node:
    joint = request.get("joint")
    if not isinstance(joint, str) or joint not in cabinet.nodes:
        raise BadOrder(f"joint {joint!r} is none of {', '.join(cabinet.nodes)}")
    return cabinet.nodes[joint]


def _number(request: Request, field: str, highest: int = 0xFFFFFFFF) -> int:
    value = request.get(field)
    if not isinstance(value, int) or isinstance(value, bool) or not 0 <= value <= highest:
        raise BadOrder(f"{field}: {value!r} is not a whole number from 0 to {highest}")
    return value


def _flag(request: Request) -> bool:
    value = request.get("on")
    if not isinstance(value, bool):
        raise BadOrder(f"on: {value!r} is neither true nor false")
    return value
