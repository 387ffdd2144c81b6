"""Pairs of TPDOs: every way to lose, double or delay frames, tried out."""

from collections.abc import Iterator
from itertools import combinations, pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.canopen.frames import MotionPdo, PositionPdo
from drivers.canopen.samples import Pairing, Sample

SYNCS = 7
Item = MotionPdo | PositionPdo | None  # None: SYNC


def motion(velocity: int) -> MotionPdo:
    return MotionPdo(1, 0x27, velocity, 5)


def stream(count: int = SYNCS) -> list[Item]:
    """SYNC k is answered by velocity k and position k."""
    return [item for k in range(count) for item in (None, motion(k), PositionPdo(1, k, 100 + k))]


def pair(items: list[Item], counter: int = 99) -> list[Sample]:
    pairing = Pairing(counter)
    samples: list[Sample] = []
    for item in items:
        if item is None:
            pairing.sync()
        elif isinstance(item, MotionPdo):
            pairing.motion(item)
        elif (sample := pairing.position(item)) is not None:
            samples.append(sample)
    return samples


def faults(at: int) -> Iterator[tuple[str, int]]:
    """What may happen to the frame at this place of the stream."""
    yield "lost", 0
    yield "doubled", 0
    for by in range(1, 7):
        yield "late", by


def spoilt(items: list[Item], *happenings: tuple[int, str, int]) -> list[Item]:
    keyed: list[tuple[float, Item]] = []
    at = dict.fromkeys(range(len(items)), ("", 0)) | {place: (what, by) for place, what, by in happenings}
    for place, item in enumerate(items):
        what, by = at[place]
        if what == "lost":
            continue
        keyed.append((place + by + 0.5 if what == "late" else place, item))
        if what == "doubled":
            keyed.append((place + 0.1, item))
    return [item for _, item in sorted(keyed, key=lambda each: each[0])]


FRAMES = [place for place, item in enumerate(stream()) if item is not None]


def test_pairs_of_one_sync_are_numbered_by_the_drive() -> None:
    assert [(s.index, s.velocity, s.position) for s in pair(stream())] == [(k, k, k) for k in range(SYNCS)]


def test_no_single_frame_lost_doubled_or_late_mixes_a_sample_or_costs_more_than_three() -> None:
    for place in FRAMES:
        for what, by in faults(place):
            samples = pair(spoilt(stream(), (place, what, by)))
            assert all(s.index == s.velocity == s.position for s in samples), (place, what, by)
            assert len(samples) >= SYNCS - 3, (place, what, by)
            assert all(a.index < b.index for a, b in pairwise(samples))


def test_two_mishaps_may_mix_a_sample_but_only_near_a_gap() -> None:
    for first, second in combinations(FRAMES[:-2], 2):
        for one in faults(first):
            for other in faults(second):
                samples = pair(spoilt(stream(), (first, *one), (second, *other)))
                present = {s.index for s in samples}
                for s in samples:
                    if not s.index == s.velocity == s.position:
                        assert set(range(s.index - 2, s.index + 3)) - present, (first, one, second, other)


def test_a_drive_that_sends_tpdo2_first_gives_no_samples_at_all() -> None:
    items = [item for k in range(50) for item in (None, PositionPdo(1, k, 100 + k), motion(k))]
    assert pair(items) == []


def test_answers_later_than_a_cycle_are_paired_all_the_same() -> None:
    items: list[Item] = [None, None, None, *(item for item in stream() if item is not None), *[None] * SYNCS]
    ahead = [*[None] * SYNCS, *(item for item in stream() if item is not None)]
    assert [s.index for s in pair(ahead)] == list(range(SYNCS))
    assert [s.index for s in pair(items)] == [0, 1, 2]  # what answers a SYNC that was not yet sent is not of this sweep


def test_a_repeated_reading_is_no_doubled_frame_and_a_doubled_one_no_reading() -> None:
    standing = [item for k in range(4) for item in (None, motion(0), PositionPdo(1, 0, 100 + k))]
    assert [s.index for s in pair(standing)] == [0, 1, 2, 3]
    without_place = standing[:5] + standing[6:]
    assert [s.index for s in pair(without_place)] == [0, 2, 3]


@pytest.mark.parametrize("counter", [0xFFFFFFFE, 0x7FFFFFFF])
def test_a_counter_that_wraps(counter: int) -> None:
    items = [item for k in range(4) for item in (None, motion(k), PositionPdo(1, k, (counter + 1 + k) & 0xFFFFFFFF))]
    assert [s.index for s in pair(items, counter)] == [0, 1, 2, 3]


def test_a_counter_that_stands_still_or_goes_back_gives_nothing() -> None:
    items: list[Item] = stream(3)
    for k in (2, 2, 1, 0, 2):
        items += [None, motion(9), PositionPdo(1, 9, 100 + k)]
    assert [s.index for s in pair(items)] == [0, 1, 2]


@given(
    st.lists(st.one_of(st.none(), st.booleans(), st.integers(0, 0xFFFFFFFF)), max_size=50), st.integers(0, 2**32 - 1)
)
def test_indices_only_grow(items: list[int | bool | None], counter: int) -> None:
    made: list[Item] = [
        motion(0) if item is True else None if not item else PositionPdo(1, 0, (counter + int(item) % 8) & 0xFFFFFFFF)
        for item in items
    ]
    indices = [s.index for s in pair(made, counter)]
    assert indices == sorted(set(indices))
    assert all(index >= 0 for index in indices)
