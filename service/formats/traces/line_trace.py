"""A trace of a Sinumerik Solution Line (*Diagnostics, Trace*): XML, root `traceSession`, of both families of set-up.

Each `dataFrame` is one session: signals by name, address (``[u1, 3]``: axis 3), `unitsType` and interval, and for each
instant a `rec` with the values that have changed since the one before. So a value that is not written holds; a signal
with a longer interval than the others is interpolated between its own samples.

Units are those that the control shows: position in deg (mm), speed in rev/min (mm/min), torque in N m and current in A
of the motor. `unitsType` of the torque may differ in set-up and data; its ratio to the current shows what it is.
"""

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from service import BadInput
from service.formats.sinumerik.members import parse
from service.formats.traces.containers import ChannelName, ListedChannel, Taken, check_numbers, shown
from service.formats.traces.units import axis_of, role_of
from service.model import Array
from service.store.files.columns import LARGEST_CSV, MOST_NUMBERS

_UNITS = {"posn": "posn", "velo": "velo", "torque": "motor Nm", "force": "N", "current": "A", "percent": "%"}
_NAMES = (
    (r"ActPos1stEnc", "position"), (r"ActPos2ndEnc", "load_position"), (r"(Cmd|Des|Set)Pos", "set_position"),
    (r"ActVelMot", "velocity"), (r"ActVel1stEnc", "velocity 1"), (r"ActVel2ndEnc", "load_velocity"),
    (r"(Cmd|Des|Set|Ctrl\w*)(Vel|Speed)", "velocity_setpoint"), (r"ActTorque|ActTrq", "effort"),
    (r"CmdTorque|CmdTrq", "effort 1"), (r"ActCurr", "current"), (r"DrvLoad", "load"),
    (r"(Ctrl|Cont|Pos|Meas)\w*(Dev|Diff|Err)|Tool|Base|[WM]cs", ""),
)  # fmt: skip


@dataclass(slots=True)
class _Signal:
    name: str
    units: str
    interval: float
    identifier: str
    times: list[float] = field(default_factory=list[float])
    values: list[float] = field(default_factory=list[float])


@dataclass(slots=True)
class Session:
    """One frame of data: signals by identifier, times of its records."""

    started: str = ""
    lost: int = 0
    signals: dict[str, _Signal] = field(default_factory=dict[str, _Signal])
    times: list[float] = field(default_factory=list[float])


class LineTrace:
    """A file of sessions. BadInput if it is no such trace, torn or too large."""

    def __init__(self, path: Path) -> None:
        self._place = str(path)
        builder = _SessionBuilder(str(path))
        parse(path, builder, LARGEST_CSV)
        self.sessions = [one for one in builder.sessions if one.times and one.signals]
        if not self.sessions:
            raise BadInput(str(path), "has no session with records: save the trace with its data")
        self._set_up = builder.units
        self.listed = tuple(
            one for number, session in enumerate(self.sessions, start=1) for one in self._of_session(number, session)
        )

    def _of_session(self, number: int, session: Session) -> list[ListedChannel]:
        roles = {key: _role(signal.name) for key, signal in session.signals.items()}
        axes = {key: axis_of(ListedChannel(name=signal.name)) for key, signal in session.signals.items()}
        for axis in set(axes.values()):
            own = [key for key in roles if axes[key] == axis]
            there = {roles[key].partition(" ")[0] for key in own}
            best = {role: min(roles[key] for key in own if roles[key].startswith(role)) for role in there if role}
            for key in own:
                role = roles[key].partition(" ")[0]
                roles[key] = role if best.get(role) == roles[key] else ""
                # an axis may have one of the two
                for wanted, instead in {"position": "load_position", "velocity": "load_velocity"}.items():
                    if role == instead and wanted not in there:
                        roles[key] = wanted
        named = ((signal.name, self._unit(signal, roles[key]), key) for key, signal in session.signals.items())
        return [
            ListedChannel(name=name, unit=unit, group=number, role=roles[key] or "other", axis=axes[key])
            for name, unit, key in named
        ]

    def _unit(self, signal: _Signal, role: str) -> str:
        by_role = {"effort": "motor Nm", "current": "A", "load": "%"}
        by_role |= dict.fromkeys(("position", "set_position", "load_position"), "posn")
        if role == "velocity" and re.search("VelMot", signal.name):
            return "velo motor"
        return _UNITS.get(signal.units) or _UNITS.get(self._set_up.get(signal.name, "")) or by_role.get(role, "")

    def read(self, channels: Sequence[ChannelName]) -> Taken:
        """The signals of one session, on the grid of the shortest interval of them."""
        groups = {channel.group for channel in channels}
        number = next((int(str(group)) for group in groups if group is not None and str(group).isdigit()), 1)
        if not 1 <= number <= len(self.sessions):
            raise BadInput(self._place, f"has sessions 1 to {len(self.sessions)}, not {number}")
        session = self.sessions[number - 1]
        signals = [self._signal(session, channel.source) for channel in channels]
        grid = _grid(session, signals, self._place)
        check_numbers(len(grid), len(signals), MOST_NUMBERS, self._place)
        values = [_on(signal, grid) for signal in signals]
        listed = {one.name: one for one in self.listed if one.group == number}
        notes = [*self._told(session, signals, listed, grid, values)]
        if session.lost:
            notes.append(f"the control lost {session.lost} values, for which the one before is held")
        if len(self.sessions) > 1 and groups == {None}:
            notes.append(f"of {len(self.sessions)} sessions the first is taken; `group` of the sweep chooses another")
        units = tuple(listed[signal.name].unit for signal in signals)
        return Taken(np.array(values), units, grid - grid[0], tuple(notes))

    def _signal(self, session: Session, source: str) -> _Signal:
        wanted = source.strip()
        found = [one for one in session.signals.values() if wanted in (one.name, one.identifier)]
        if not found:
            names = [f"{one.identifier} {one.name}" for one in session.signals.values()]
            raise BadInput(self._place, f"has no signal {source!r}; there are {shown(names)}")
        return found[0]

    def _told(
        self,
        session: Session,
        signals: list[_Signal],
        listed: dict[str, ListedChannel],
        grid: Array,
        values: list[Array],
    ) -> Iterator[str]:
        for signal, value in zip(signals, values, strict=True):
            told, axis = signal.identifier, listed[signal.name].axis
            if listed[signal.name].role != "effort":
                continue
            other = self._set_up.get(signal.name, signal.units)
            if other != signal.units:
                yield f"{told} is {other!r} in the set-up, {signal.units!r} in the data; taken: the motor's"
            roles = ((one, listed[one.name]) for one in session.signals.values())
            current = next((one for one, named in roles if (named.role, named.axis) == ("current", axis)), None)
            if current is not None and current.values:
                flow, pull = (np.convolve(one, np.ones(8), "valid") for one in (_on(current, grid), value))  # samples
                power, along = float(flow @ flow) * float(pull @ pull), float(flow @ pull)
                # correlation of a torque and its current, which is some samples later
                if power > 0 and abs(along) / power**0.5 > 0.8:
                    per = f"{along / float(flow @ flow):.3g} N m per A of i_q, {current.identifier}"
                    yield f"{told} is {per}: the motor's torque"
                else:
                    yield f"{told} does not follow i_q, {current.identifier}: check that it is the torque"


class _SessionBuilder:
    """Of the elements that have a meaning."""

    def __init__(self, place: str) -> None:
        self.units: dict[str, str] = {}  # of the set-up, by name
        self.sessions: list[Session] = []
        self._place = place
        self._depth = 0

    def start(self, kind: str, given: dict[str, str]) -> None:
        if self._depth == 0 and kind != "traceSession":
            raise BadInput(self._place, f"is a {kind}, not a traceSession")
        self._depth += 1
        match kind:
            case "signal":
                self.units[given.get("name", "")] = given.get("unitsType", "")
            case "dataFrame":
                self.sessions.append(Session())
            case "frameHeader" if self.sessions:
                self.sessions[-1].started = given.get("startTime", "")
                self.sessions[-1].lost = int(self._number(given.get("dropOuts", "0"), "dropOuts"))
            case "dataSignal" if self.sessions:
                key = given.get("id", "")
                interval = self._number(given.get("interval", "0"), f"interval of {key}")
                name = given.get("name") or given.get("description") or key
                self.sessions[-1].signals[key] = _Signal(name, given.get("unitsType", ""), interval, key)
            case "rec" if self.sessions:
                self._record(self.sessions[-1], given)
            case _:
                pass

    def end(self, _: str) -> None:
        self._depth -= 1

    def characters(self, _: str) -> None:
        pass  # values are attributes

    def _record(self, session: Session, given: dict[str, str]) -> None:
        time = self._number(given.get("time", "nan"), f"time of record {len(session.times) + 1}")
        if session.times and not time > session.times[-1]:
            told = f"time does not increase at record {len(session.times) + 1}: {time} s after {session.times[-1]} s"
            raise BadInput(self._place, told)
        session.times.append(time)
        for key, text in given.items():
            if key in session.signals:
                session.signals[key].times.append(time)
                session.signals[key].values.append(self._number(text, f"{key} at {time} s"))

    def _number(self, text: str, what: str) -> float:
        try:
            value = float(text.replace(",", "."))
        except ValueError:
            value = float("nan")
        if not abs(value) < 1e15:
            raise BadInput(self._place, f"{what} is {text!r}, not a number")
        return value


def _role(name: str) -> str:
    bare = name.rpartition("/")[2]
    found = next((role for pattern, role in _NAMES if re.search(pattern, bare)), None)
    return role_of(ListedChannel(name=bare))[0] if found is None else found


def _grid(session: Session, signals: Sequence[_Signal], place: str) -> Array:
    """Even times, s, at the shortest interval, from when all signals have a value."""
    for signal in signals:
        if not signal.values:
            raise BadInput(place, f"signal {signal.identifier} {signal.name} has no values")
    stated = [signal.interval for signal in signals if signal.interval > 0]
    interval = min(stated) if stated else float(np.median(np.diff(session.times))) if len(session.times) > 1 else 1.0
    start, end = max(signal.times[0] for signal in signals), session.times[-1]
    check_numbers(round((end - start) / interval), len(signals), MOST_NUMBERS, place)
    return start + interval * np.arange(int((end - start) / interval + 1e-6) + 1, dtype=np.float64)


def _on(signal: _Signal, grid: Array) -> Array:
    times, values = np.array(signal.times), np.array(signal.values)

    def held(at: Array) -> Array:
        slack = 0.25 * (grid[1] - grid[0]) if len(grid) > 1 else 0.0
        return values[np.clip(np.searchsorted(times, at + slack, side="right") - 1, 0, len(times) - 1)]

    if len(grid) < 2 or signal.interval <= 1.5 * (grid[1] - grid[0]):
        return held(grid)
    own = times[0] + signal.interval * np.arange(int((grid[-1] - times[0]) / signal.interval + 1e-6) + 1)
    return np.interp(grid, own, held(own))
