"""What no name of the catalogue covers: the right verdict is `unknown`."""

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from tests.numeric.second_plant.draft import Draft, Hidden
from tests.numeric.second_plant.friction import Now
from tests.numeric.second_plant.laws import Law
from tests.numeric.second_plant.plans import Random

Array = NDArray[np.float64]


def floor_vibration(draft: Draft) -> Hidden:
    """A press next door shakes the base; no two sweeps meet it at the same phase."""
    frequency = draft.random.uniform(4.0, 11.0)
    frequency += 0.25 if abs(frequency - round(frequency)) < 0.1 else 0.0
    phases = draft.each(0, 2 * np.pi)
    sizes = draft.size * draft.each(0.7, 1.3)
    draft.train.on_load.append(Law(lambda now: sizes * np.sin(2 * np.pi * frequency * now.time + phases)))
    return Hidden({"amplitude": draft.size, "frequency": frequency})


def tilted_base(draft: Draft) -> Hidden:
    """The first axis is not plumb: weight pulls where CAD knows of none."""
    way = draft.random.uniform(0, 2 * np.pi)

    def lean(angle: float) -> float:
        side = 9.81 * np.sin(angle)
        draft.tilted = (float(side * np.cos(way)), float(side * np.sin(way)), float(-9.81 * np.cos(angle)))
        draft.rebuild(draft.built)
        return draft.weight()

    angle = 0.02 * draft.size / lean(0.02)
    lean(angle)
    return Hidden({"angle": angle, "direction": way})


def dragging_brake(draft: Draft) -> Hidden:
    """The holding brake touches now and then, for some tenths of a second."""
    times, touches = 400, np.empty((400, draft.sweeps))
    touching = draft.each(0.0, 1.0) < 0.3
    for n in range(times):
        change = draft.each(0.0, 1.0) < np.where(touching, 0.08, 0.04)
        touching = touching ^ change
        touches[n] = touching * draft.random.uniform(0.7, 1.3)
    there = 2.0 * draft.size

    def drags(now: Now) -> Array:
        row = touches[min(int(now.time * 100), times - 1)]  # one a hundredth of a second
        return there * row * np.tanh(now.velocity / 1e-3)

    draft.train.on_motor.append(Law(drags))
    return Hidden({"torque": there})


def loose_connection(draft: Draft) -> Hidden:
    """At one angle a cable breaks contact and part of the current asked for never flows."""
    starts = draft.starts
    part = min(0.5, 4.0 * draft.size / (draft.weight() + 0.08 * draft.rated))
    angles = np.unique(starts) + draft.random.uniform(0.01, 0.05, len(np.unique(starts)))
    width = draft.random.uniform(0.004, 0.012)

    def arrives(now: Now) -> Array:
        near = np.abs(now.position[:, None] - angles).min(axis=1)
        return 1.0 - part * (near < width)

    draft.train.delivered = arrives
    return Hidden({"part": part, "angles": angles.tolist(), "width": width})


def yielding_neighbour(draft: Draft) -> Hidden:
    """The next axis is held by a soft brake: a part of the load hangs on a spring and resonates."""
    frequency = draft.random.uniform(5.0, 11.0)
    part = {"small": 0.03, "medium": 0.1, "large": 0.25}[draft.size_class]
    mass = part * draft.train.load
    draft.train.load = draft.train.load - mass
    stiffness, damping = mass * (2 * np.pi * frequency) ** 2, 2 * 0.04 * mass * 2 * np.pi * frequency
    draft.train.on_load.append(_Hanging(mass, stiffness, damping))
    return Hidden({"frequency": frequency, "part": part})


def counterbalance(draft: Draft) -> Hidden:
    """A gas cylinder between two points, which CAD lacks: force by its length, lever by the angle."""
    crank, arm = draft.random.uniform(0.12, 0.2), draft.random.uniform(0.25, 0.4)
    at = float(draft.random.uniform(draft.starts.min(), draft.starts.max()))

    def shape(position: Array) -> Array:
        angle = position - at
        length = np.sqrt(crank**2 + arm**2 - 2 * crank * arm * np.cos(angle))
        gas = 1.0 / (1.0 - 0.6 * (length - (arm - crank)) / (2 * crank))  # an isothermal column
        return gas * crank * arm * np.sin(angle) / length

    force = 3.0 * draft.size / float(np.abs(shape(draft.starts)).max())
    draft.train.on_load.append(Law(lambda now: force * shape(now.position)))
    return Hidden({"force": force, "crank": crank, "arm": arm, "zero": at})


def sagging_supply(draft: Draft) -> Hidden:
    """The supply's voltage wanders, and with it the torque that a count of current gives."""
    wander = draft.each(0.0, 1.0, Random.normal)
    share = 2.0 * draft.size / (draft.weight() + 0.15 * draft.rated)
    gain = 1.0 + share * wander / np.abs(wander[: draft.drawn]).max()
    draft.train.delivered = lambda now: gain
    return Hidden({"share": share})


def dry_seal(draft: Draft) -> Hidden:
    """A seal that sticks after standing and loosens as it runs: extra drag that dies away within each sweep."""
    pace = draft.random.uniform(0.5, 1.5)
    extra = 3.0 * draft.size

    def loosens(now: Now) -> Array:
        return extra * np.exp(-max(now.time - 0.7, 0.0) / pace) * np.tanh(now.velocity / 1e-3)

    draft.train.on_motor.append(Law(loosens))
    return Hidden({"torque": extra, "time_constant": pace})


@dataclass
class _Hanging:
    """A mass on a spring that is carried along; its own leapfrog, in step with the axis'."""

    mass: Array
    stiffness: Array
    damping: Array
    position: Array | None = None
    velocity: Array = field(default_factory=lambda: np.zeros(1))

    def torque(self, now: Now) -> Array:
        if self.position is None:
            self.position, self.velocity = now.position.copy(), np.zeros_like(now.position)
        middle = self.position + now.step / 2 * self.velocity
        carried = self.stiffness * (now.position - middle) + self.damping * (now.velocity - self.velocity)
        self.velocity = self.velocity + now.step * carried / self.mass
        self.position = middle + now.step / 2 * self.velocity
        return carried


OUTSIDE: dict[str, Callable[[Draft], Hidden]] = {
    effect.__name__: effect
    for effect in (
        floor_vibration, tilted_base, dragging_brake, loose_connection, yielding_neighbour, counterbalance,
        sagging_supply, dry_seal,
    )
}  # fmt: skip

PLUMB = ("tilted_base",)  # needs a first axis that is upright
SWINGING = ("counterbalance",)  # sits where weight pulls
