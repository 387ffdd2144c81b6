"""One drive: the power state machine of IEC 61800-7-201 and its set-points, over a durand node and a plant."""

import math
from typing import Any

from durand import MinimalNode
from durand.services.nmt import StateEnum as Nmt

from tests.durand_nodes.network import Network
from tests.durand_nodes.objects import ENCODER, GEAR, MODES, RATED, SPEEDS, TURN, furnish
from tests.durand_nodes.plant import NOISE, STEP, STIFFNESS, Plant

DISABLED, READY, ON, ENABLED, QUICK, REACTION, FAULT = 0x40, 0x21, 0x23, 0x27, 0x07, 0x0F, 0x08
ENERGISED = (ENABLED, QUICK, REACTION)
PP, PV, CSV = 1, 3, 9
SYNC_LOST = 5.0  # s without SYNC, after which time goes on by itself
LAG, LAG_TIME = 0.05, 0.2  # rad/s of set-point and speed apart, for s: fault 8400h
STANDS = 9e-4  # rad/s


class Drive:
    """`run` when time goes by; everything else comes over the network."""

    def __init__(self, number: int, network: Network, plant: Plant, modes: str) -> None:
        self.network, self.plant = network, plant
        self.node = MinimalNode(network, number)
        furnish(self.node, MODES[modes], 0x0D00 + number)
        self._od: Any = self.node.object_dictionary
        self.state, self.code, self.pressed = DISABLED, 0, False
        self._word = self._mode = 0
        self._after: int | None = None  # state at the end of a ramp
        self._speed = 0.0  # of the profile, rad/s
        self._offset = 0.0  # 60B1h in profile velocity, rad/s: past the ramps
        self._goal, self._left = 0.0, 0  # of an interpolation, and its steps to go
        self._reference, self._target = plant.position, None
        self._acknowledged = False
        self._lagging = 0.0
        self._means = plant.position, 0.0, 0.0  # position, speed, effort over the last SYNC period: what TPDOs say
        self._synced = -math.inf
        self.syncs = 0
        self._now = 0.0
        self._heard: float | None = None  # the host's heartbeat
        self.node.sync.callbacks.add(self._sync)  # before all PDOs: they tell what is so at SYNC
        self._od.update_callbacks[0x6040, 0].add(self._control)
        self._od.update_callbacks[0x1016, 1].add(self._watch_host)
        self.node.nmt.state_callbacks.add(self._nmt)
        self._tell()

    # -- time ----------------------------------------------------------------------------------------------------

    @property
    def led(self) -> bool:
        """Whether SYNC is its clock."""
        return self.state == ENABLED and self._mode in (PV, CSV) and self._now - self._synced < SYNC_LOST

    def run(self, now: float, steps: int) -> None:
        """`steps` of the plant have gone by on the clock, unless SYNC leads."""
        self._now = now
        if not self.led:
            self._advance(steps)
            plant = self.plant  # a mean over the time that a busy computer took would lag behind "target reached"
            self._means = plant.position, plant.velocity, plant.effort
            self._tell()
        timeout = (self._od.read(0x1016, 1) & 0xFFFF) * 1e-3
        if self._heard is not None and timeout and now - self._heard > timeout:
            self._heard = None
            self._lose_host(0x8130)

    def _sync(self) -> None:
        led = self.led
        self._synced = self._now
        self.syncs += 1
        if led:
            self._advance(round(self._od.read(0x1006, 0) * 1e-6 / STEP))
        self._tell()

    def _advance(self, steps: int) -> None:
        if self.state not in ENERGISED:
            return
        od, plant = self._od, self.plant
        plant.effort_limit = od.read(0x6072, 0) * 1e-3 * RATED * GEAR
        self._offset = self._rad_s(od.read(0x60B1, 0)) if self._mode == PV else 0.0
        if self._mode == CSV and (goal := self._rad_s(od.read(0x60FF, 0) + od.read(0x60B1, 0))) != self._goal:
            self._goal, self._left = goal, round(od.read(0x60C2, 1) * 10.0 ** od.read(0x60C2, 2) / STEP)
        position = velocity = effort = 0.0
        for _ in range(steps):
            wanted = self._set_point()
            plant.step(wanted)
            self._watch(wanted)
            if self.state not in ENERGISED:
                return
            position, velocity, effort = (
                position + plant.position,
                velocity + plant.mean_velocity,
                effort + plant.effort,
            )
        if steps:
            self._means = position / steps, velocity / steps, effort / steps

    def _watch(self, wanted: float) -> None:
        self._lagging = self._lagging + STEP if abs(wanted - self.plant.velocity) > LAG else 0.0
        low, high = (self._od.read(0x607D, sub) / (TURN * ENCODER) for sub in (1, 2))
        if self.state == ENABLED and self._lagging > LAG_TIME:
            self.fail(0x8400)
        elif self.state == ENABLED and not low <= self.plant.position <= high:
            self.fail(0x8612)
        elif self._after is not None and self._speed == 0.0 and abs(self.plant.velocity) < STANDS:
            self._enter(self._after)

    # -- set-points ----------------------------------------------------------------------------------------------

    def _set_point(self) -> float:
        od = self._od
        if self._after is not None or self.state == QUICK:
            return self._ramped(0.0, 0x6085)
        if self._mode == PP:
            return self._travelled()
        if self._mode == CSV:
            if self._left > 0:
                self._speed += (self._goal - self._speed) / self._left
                self._left -= 1
            return self._speed
        if self._mode == PV:
            return self._ramped(self._rad_s(od.read(0x60FF, 0)), 0x6083) + self._offset
        return self._ramped(0.0, 0x6085)

    def _ramped(self, goal: float, ramp: int) -> float:
        step = self._rad_s(self._od.read(ramp, 0)) * STEP
        self._speed += min(max(goal - self._speed, -step), step)
        return self._speed

    def _travelled(self) -> float:
        """To the target along a trapezoid, and held there."""
        if self._target is not None:
            left = self._target - self._reference
            brake = self._rad_s(self._od.read(0x6084, 0))
            most = min(self._rad_s(self._od.read(index, 0)) for index in (0x6081, 0x607F))
            allowed = math.sqrt(max(0.0, 2 * brake * abs(left))) * 0.98
            self._ramped(math.copysign(min(most, allowed), left), 0x6083)
            if abs(left) <= abs(self._speed) * STEP or abs(left) < 1e-9:
                self._reference, self._speed = self._target, 0.0
            else:
                self._reference += self._speed * STEP
        return self._speed + STIFFNESS * (self._reference - self.plant.position)

    @staticmethod
    def _rad_s(raw: float) -> float:
        return raw / SPEEDS / TURN

    # -- power ---------------------------------------------------------------------------------------------------

    def _control(self, word: int) -> None:
        before, self._word = self._word, word
        state = self.state
        if state == FAULT:
            if word & ~before & 0x80 and not self.pressed:
                self.code = 0
                self.node.emcy.set(0, 0)
                self._enter(DISABLED)
        elif state == REACTION:
            pass
        elif not word & 0x02:
            self._enter(DISABLED)
        elif not word & 0x04:
            if state == ENABLED:
                self.state, self._lagging = QUICK, 0.0
                self._after = DISABLED if self._od.read(0x605A, 0) == 2 else None
            elif state in (READY, ON):
                self._enter(DISABLED)
        elif word & 0x07 == 0x06:
            self._enter({QUICK: QUICK}.get(state, READY))
        elif word & 0x0F == 0x07:
            self._enter({READY: ON, ENABLED: ON}.get(state, state))
        elif word & 0x0F == 0x0F:
            if state == ON:
                self._start()
            elif state == ENABLED:
                self._operate(before)
        self._tell()

    def _start(self) -> None:
        self._enter(ENABLED)
        self._speed, self._goal, self._left = 0.0, 0.0, 0
        self._reference, self._target, self._acknowledged = self.plant.position, None, False

    def _operate(self, before: int) -> None:
        if self._mode != PP:
            return
        if not self._word & 0x10:
            self._acknowledged = False
        elif not before & 0x10:
            self._target = self._od.read(0x607A, 0) / (TURN * ENCODER)
            self._acknowledged = True

    def _enter(self, state: int) -> None:
        if state != self.state:
            self._after, self._lagging = None, 0.0
        self.state = state
        if state not in ENERGISED:
            self._speed = 0.0
            self.plant.stand()

    def fail(self, code: int) -> None:
        """A fault: the axis brakes, then loses its energy."""
        self.code = code
        self.node.emcy.set(code, 1)
        if self.state in ENERGISED and self._od.read(0x605E, 0) == 2:
            self.state, self._after = REACTION, FAULT
        else:
            self._enter(FAULT)
        self._tell()

    def press(self, on: bool, code: int) -> None:
        """Safe torque off: at once."""
        self.pressed = on
        if on:
            self.code = code
            self.node.emcy.set(code, 1)
            self._enter(FAULT)
            self._tell()

    # -- host and network ----------------------------------------------------------------------------------------

    def _watch_host(self, value: int) -> None:
        def hear(_: int, __: bytes) -> None:
            self._heard = self._now

        if value >> 16 & 0x7F:
            self.network.add_subscription(0x700 + (value >> 16 & 0x7F), hear)

    def _lose_host(self, code: int) -> None:
        option = self._od.read(0x6007, 0)
        if self.state not in ENERGISED or option == 0:
            return
        if option == 1:
            self.fail(code)
        elif option == 2:
            self._enter(DISABLED)
        else:
            self.state, self._after = QUICK, DISABLED
        self._tell()

    def _nmt(self, state: Nmt) -> None:
        if state == Nmt.STOPPED:
            self._lose_host(0x8100)
        elif state == Nmt.INITIALISATION:
            self._enter(DISABLED)
            self._tell()

    # -- actual values -------------------------------------------------------------------------------------------

    def _tell(self) -> None:
        od, plant, enabled = self._od, self.plant, self.state == ENABLED
        if (asked := od.read(0x6060, 0)) != self._mode and abs(plant.velocity) < STANDS and self._speed == 0.0:
            self._mode, self._goal, self._left, self._target = asked, 0.0, 0, None
            self._reference = plant.position
        arrived = self._target is None or self._reference == self._target
        reached = abs(plant.velocity) < STANDS and (self._mode != PP or arrived) and self._left == 0
        word = (
            self.state | 0x200 | (0 if self.pressed else 0x10) | (0x400 if reached and self.state in ENERGISED else 0)
        )
        word |= 0x1000 if enabled and (self._acknowledged if self._mode == PP else self._mode == CSV) else 0
        if self.state not in ENERGISED:
            self._means = plant.position, 0.0, 0.0
        position, velocity, effort = self._means
        noise = NOISE * plant.noise.gauss() if self.state in ENERGISED else 0.0
        for index, value in (
            (0x603F, self.code),
            (0x6041, word),
            (0x6061, self._mode),
            (0x6064, round(position * TURN * ENCODER)),
            (0x606C, round(velocity * TURN * SPEEDS)),
            (0x6077, max(-32768, min(32767, round(effort / (RATED * GEAR) * 1e3 + noise)))),
        ):
            od.write(index, 0, value)
