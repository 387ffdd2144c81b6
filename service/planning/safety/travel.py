"""The path between poses: one axis at a time, collision-free, short."""

from collections.abc import Sequence
from itertools import permutations

import numpy as np
from numpy.typing import NDArray

from service.model import Array
from service.model.collision import CollisionChecker

Leg = tuple[int, float]  # number of the joint, position to move it to, rad (m)


def route(
    checker: CollisionChecker, start: Sequence[float], goal: Sequence[float], via: Sequence[float]
) -> tuple[Leg, ...] | None:
    """Collision-free legs from `start` to `goal`, each moving one joint; None if none of those tried is free.

    Tried in this sequence: every order of the joints that differ (all take the same time); then the same with an
    intermediate stop at which an increasing number of joints, from base to tip and from tip to base, is at `via`.
    """
    direct = _direct(checker, start, goal)
    if direct is not None:
        return direct
    for stop in _stops(start, goal, via):
        to_stop = _direct(checker, start, stop)
        if to_stop is None:
            continue
        onward = _direct(checker, stop, goal)
        if onward is not None:
            return to_stop + onward
    return None


def order_poses(poses: Array, start: Array) -> list[int]:
    """An order of `poses` (m, n) with a short path from `start` through all of them; the end is free.

    Nearest neighbour, then 2-opt (Croes 1958) until no reversal of a segment shortens the path; of the segments that
    begin at one pose the best is used.
    """
    points = np.vstack([start, poses])
    distance = np.sum(np.abs(points[:, None] - points[None]), axis=-1)
    tour = _nearest_neighbours(distance)
    improved = True
    while improved:
        improved = False
        for i in range(1, len(tour) - 1):
            before, first, last = tour[i - 1], tour[i], tour[i + 1 :]  # a segment ends at any of `last`
            gain = distance[before, first] - distance[before, last]
            # an open path: nothing follows the last pose
            gain[:-1] += distance[last[:-1], last[1:]] - distance[first, last[1:]]
            best = int(np.argmax(gain))
            if gain[best] > 1e-9:
                tour[i : i + best + 2] = tour[i : i + best + 2][::-1].copy()
                improved = True
    return [int(k) - 1 for k in tour[1:]]


def _nearest_neighbours(distance: Array) -> NDArray[np.intp]:
    """From point 0 always to the nearest remaining one; the first one of equal distances."""
    tour = np.zeros(len(distance), dtype=np.intp)
    far = distance.copy()
    for k in range(1, len(tour)):
        far[:, tour[k - 1]] = np.inf
        tour[k] = np.argmin(far[tour[k - 1]])
    return tour


def _direct(checker: CollisionChecker, start: Sequence[float], goal: Sequence[float]) -> tuple[Leg, ...] | None:
    moving = [k for k in range(len(goal)) if abs(goal[k] - start[k]) > 2e-4]  # rad (m): a nearer joint is not moved
    orders = permutations(moving) if len(moving) <= 4 else iter((tuple(moving), tuple(reversed(moving))))
    for order in orders:
        pose = list(start)
        legs: list[Leg] = []
        for joint in order:
            if not checker.leg_free(pose, joint, goal[joint]):
                break
            pose[joint] = goal[joint]
            legs.append((joint, goal[joint]))
        else:
            return tuple(legs)
    return None


def _stops(start: Sequence[float], goal: Sequence[float], via: Sequence[float]) -> list[list[float]]:
    """Start, then goal, with the first 1, 2, ... and the last 1, 2, ... joints at their via positions."""
    count = len(goal)
    stops: list[list[float]] = []
    for pose in (start, goal):
        for k in range(1, count + 1):
            stops.append([*via[:k], *pose[k:]])
            stops.append([*pose[: count - k], *via[count - k :]])
    return stops
