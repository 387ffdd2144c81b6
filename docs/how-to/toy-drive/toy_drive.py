"""A toy drive with its axis, 20 times faster than real time: it follows its set-points, against friction."""

import json
import math
import socketserver
import threading
import time

import numpy as np

SPEED, TICK = 20.0, 0.004  # ratio of its clock to real time; s of its own clock
DISABLED, READY, SWITCHED_ON, ENABLED, QUICK_STOP, FAULT = 0x40, 0x21, 0x23, 0x27, 0x07, 0x08
INERTIA, VISCOUS, COULOMB = 0.01, 0.02, 1.0  # kg m^2, N m s/rad and N m at the motor


class ToyDrive:
    """rad, rad/s, N m at the motor."""

    def __init__(self) -> None:
        self.lock = threading.RLock()
        self.state, self.error, self.reached, self.stopping = DISABLED, 0, False, False
        self.position = self.velocity = self.torque = 0.0
        self.goal: tuple[float, float] | None = None  # of the present move: position, velocity
        self.target = (0.0, 0.0)
        self.held = {"watchdog": 1.0, "acceleration": 1.0, "quick_stop": 1.0}
        self.who = {"vendor": 0x5459, "product": 1, "revision": 1, "serial": 7}
        self.curve, self.rows, self.measured = (
            np.zeros(0),
            [],
            0,
        )  # set-points, samples, state of the measuring function
        self.fault_at = (-1, 0)  # sample, code
        self.pressed = self.silent = False
        self.began = self.heard = time.monotonic()
        self.ticks = 0

    # -- requests of a client

    def control(self, word: int) -> None:
        before, kind = self.state, word & 0x0F
        if word & 0x80 and before == FAULT and not self.pressed:
            self.state, self.error = DISABLED, 0
        elif before == FAULT:
            return
        elif not word & 0x02:
            self.state = DISABLED
        elif not word & 0x04:
            self.state = QUICK_STOP if before == ENABLED else DISABLED if before != QUICK_STOP else before
        elif kind == 0x06 and before == DISABLED:
            self.state = READY
        elif kind == 0x07 and before == READY:
            self.state = SWITCHED_ON
        elif kind == 0x0F and before in (SWITCHED_ON, ENABLED):
            self.state = ENABLED
            self.stopping = bool(word & 0x100)
            if word & 0x10:
                self.goal, self.reached = self.target, False
        if self.state != ENABLED:
            self.goal = None
            self._end(3)

    def statusword(self) -> int:
        acknowledged = 0x1000 if self.goal == self.target else 0
        return self.state | (0x400 if self.reached else 0) | acknowledged

    def settings(self, values: dict[str, float]) -> dict[str, float]:
        self.held |= values
        return self.held

    def wave(self, wave: dict) -> dict:
        at = np.arange(round(wave["duration"] / TICK)) * TICK
        rising = np.clip(np.minimum(at, wave["duration"] - at) / wave["ramp"], 0.0, 1.0)
        since = 2 * np.pi * (at - wave["start"])
        sines = sum(one["amplitude"] * np.sin(one["frequency"] * since + one["phase"]) for one in wave["sines"])
        self.curve = (0.5 - 0.5 * np.cos(np.pi * rising)) * (wave["offset"] + sines)
        return wave

    def start(self) -> None:
        self.rows, self.measured = [], 1 if self.state == ENABLED and not self.stopping else 4
        self.goal = None

    def abort(self) -> None:
        self._end(3)

    def page(self, first: int, count: int) -> list[list[float]]:
        return self.rows[first : first + count]

    def fail(self, code: int) -> None:
        """Torque off, brake closed."""
        self.state, self.error, self.velocity, self.goal = FAULT, code, 0.0, None
        self._end(3)

    # -- its clock

    def run_on(self) -> None:
        """Simulate up to the present time."""
        until = int((time.monotonic() - self.began) * SPEED / TICK)
        while self.ticks < until:
            self.ticks += 1
            self._tick()
        if time.monotonic() - self.heard > self.held["watchdog"] and self.state == ENABLED:
            self.control(0x02)

    def _tick(self) -> None:
        if self.measured == 1 and len(self.rows) == self.fault_at[0]:
            code, self.fault_at = self.fault_at[1], (-1, 0)
            self.fail(code)
        wanted, before = self._wanted(), self.velocity
        self.velocity = wanted if self.state in (ENABLED, QUICK_STOP) else 0.0
        self.position += self.velocity * TICK
        friction = VISCOUS * self.velocity + COULOMB * math.copysign(1.0, self.velocity) * (self.velocity != 0)
        self.torque = INERTIA * (self.velocity - before) / TICK + friction
        if self.measured == 1:
            row = [float(len(self.rows)), self.torque, self.velocity, self.position, wanted]
            self.rows.append(row)
            if len(self.rows) == len(self.curve):
                self.measured = 2
        elif self.state == QUICK_STOP and self.velocity == 0.0:
            self.state = DISABLED

    def _wanted(self) -> float:
        """Velocity of the next tick."""
        if self.measured == 1:
            return float(self.curve[len(self.rows)])
        most = self.held["quick_stop" if self.state == QUICK_STOP else "acceleration"] * TICK
        towards = 0.0
        if self.goal is not None and not self.stopping:
            left = self.goal[0] - self.position
            if abs(left) <= most * TICK or (abs(left) < abs(self.velocity) * TICK and abs(self.velocity) <= 2 * most):
                self.position, self.reached, self.velocity = self.goal[0], True, 0.0
                return 0.0
            fastest = min(self.goal[1], math.sqrt(self.held["acceleration"] * abs(left)))
            towards = math.copysign(min(fastest, abs(left) / TICK), left)
        return self.velocity + min(max(towards - self.velocity, -most), most)

    def _end(self, how: int) -> None:
        if self.measured == 1:
            self.measured = how

    # -- its interface

    def answer(self, line: bytes) -> dict:
        call, *values = json.loads(line)
        with self.lock:
            self.run_on()
            self.heard = time.monotonic()
            if call == "target":
                self.target = (values[0], values[1])
            told = {
                "identity": self.who, "error": self.error, "motion": [self.position, self.velocity, self.torque],
                "target": self.target, "measuring": self.measured, "recorded": len(self.rows),
            }  # fmt: skip
            if call in told:
                return {"value": told[call]}
            if call in ("control", "statusword", "settings", "wave", "start", "abort", "page"):
                return {"value": getattr(self, call)(*values)}
        return {"error": "unknown call"}


class Wire(socketserver.StreamRequestHandler):
    def handle(self) -> None:
        for line in self.rfile:
            answer = self.server.drive.answer(line)
            if not self.server.drive.silent:
                self.wfile.write(json.dumps(answer).encode() + b"\n")


class Server(socketserver.ThreadingTCPServer):
    daemon_threads = True

    def __init__(self) -> None:
        super().__init__(("127.0.0.1", 0), Wire)
        self.drive = ToyDrive()
