"""Detects another host on the bus by frames that only a host sends to these drives and that are not ours. Pure.

Our own frames are not seen here: python-can and socketcand gateways do not return them. A stop is not reported,
whoever sends it, especially the stop process, which sends nothing else (`frames.stop`): quick stop by RPDO, the SYNC
after it, NMT stop, and SDO requests that read, by which it confirms the stop (`heard_state`).
"""

from collections.abc import Iterable

from drivers.canopen import frames
from drivers.canopen.heard_state import UPLOAD

READINGS = 128  # SDO uploads after a stop that belong to it
_EVERY_NODE = 0  # in an NMT command
_SAID = {
    frames.RPDO1: "RPDO1 to",
    frames.RPDO2: "RPDO2 to",
    frames.RPDO3: "RPDO3 to",
    frames.RPDO4: "RPDO4 to",
    frames.SDO_REQUEST: "SDO request to",
}


class ForeignFrames:
    """Checks every data frame with an 11-bit identifier, in the order of the bus."""

    def __init__(self, nodes: Iterable[int], host_node: int, wires: frames.Wires = frames.VIRTUAL_WIRES) -> None:
        """`nodes`: our drives; `host_node`: node id of this host; `wires`: the RPDO that stops the drives."""
        self._nodes, self._host_node = frozenset(nodes), host_node
        self._quick_stops = frozenset(wires.stop_frame(node) for node in self._nodes)
        self._stopping = False  # a quick stop was received and its SYNC was not
        self._readings = 0  # remaining ones of the last stop

    def word(self, identifier: int, data: bytes) -> str:
        """Description of a frame from another host, with the COB-ID; "" if it does not address our drives, or is a
        stop.
        """
        said = self._said(identifier, data)
        return f"another host is on the bus: {said} (COB-ID {identifier:03X}h)" if said else ""

    def _said(self, identifier: int, data: bytes) -> str:
        if identifier == frames.SYNC:
            stopping, self._stopping = self._stopping, False
            return "" if stopping else "SYNC"
        if identifier == frames.NMT:
            return self._command(data)
        function, node = identifier & ~0x7F, identifier & 0x7F
        if function == frames.HEARTBEAT and node == self._host_node:
            return f"heartbeat with node number {node}, which this host uses"
        if node not in self._nodes or function not in _SAID:
            return ""
        if (identifier, bytes(data)) in self._quick_stops:
            self._stopping, self._readings = True, READINGS
            return ""
        if function == frames.SDO_REQUEST and data[:1] == bytes([UPLOAD]) and self._readings:
            self._readings -= 1
            return ""
        return f"{_SAID[function]} node {node}"

    def _command(self, data: bytes) -> str:
        if len(data) < 2 or data[0] == frames.NMT_STOP or data[1] not in self._nodes | {_EVERY_NODE}:
            return ""
        whom = "every node" if data[1] == _EVERY_NODE else f"node {data[1]}"
        return f"NMT command {data[0]:02X}h to {whom}"
