"""Pairs of TPDOs, with a sample counter and without: every way to lose, double or delay frames, tried out."""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import combinations, pairwise

import pytest
from hypothesis import example, given, strategies as st

from drivers.canopen.frames import MotionPdo, PositionPdo
from drivers.canopen.streamed_axis import CounterPairing, SyncSample, Windows

SYNCS = 7
Item = MotionPdo | PositionPdo | None  # None: SYNC


def motion(velocity: int) -> MotionPdo:
    return MotionPdo(1, 0x27, velocity, 5)


def stream(count: int = SYNCS) -> list[Item]:
    """SYNC k is answered by velocity k and position k."""
    return [item for k in range(count) for item in (None, motion(k), PositionPdo(1, k, 100 + k))]


def pair(items: list[Item], counter: int = 99) -> list[SyncSample]:
    pairing = CounterPairing(counter)
    samples: list[SyncSample] = []
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


ANSWERS = [item for item in stream() if item is not None]
STANDING = [item for k in range(4) for item in (None, motion(0), PositionPdo(1, 0, 100 + k))]


@pytest.mark.parametrize(
    ("items", "indices"),
    [
        ([item for k in range(50) for item in (None, PositionPdo(1, k, 100 + k), motion(k))], []),
        ([*[None] * SYNCS, *ANSWERS], list(range(SYNCS))),
        ([*[None] * 3, *ANSWERS, *[None] * SYNCS], [0, 1, 2]),
        (STANDING, [0, 1, 2, 3]),
        (STANDING[:5] + STANDING[6:], [0, 2, 3]),
    ],
    ids=["TPDO2 first", "later than a cycle", "to a SYNC not yet sent", "a repeated reading", "its place lost"],
)
def test_which_answers_are_samples(items: list[Item], indices: list[int]) -> None:
    assert [s.index for s in pair(items)] == indices


@pytest.mark.parametrize("counter", [0xFFFFFFFE, 0x7FFFFFFF])
def test_a_counter_that_wraps(counter: int) -> None:
    items = [item for k in range(4) for item in (None, motion(k), PositionPdo(1, k, (counter + 1 + k) & 0xFFFFFFFF))]
    assert [s.index for s in pair(items, counter)] == [0, 1, 2, 3]


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


TORQUE, POSITION = 1000, 100_000  # rows are numbered in them, so that a sample tells what it is made of


@dataclass(frozen=True)
class Fate:
    """Of one frame: `cycles` late (it comes after as many further SYNCs), and how often it comes."""

    late: int = 0
    copies: int = 1


Row = tuple[int, Fate, Fate, bool]  # velocity, fate of TPDO1 and TPDO2, TPDO2 comes first


def told(rows: list[Row], settled: bool = False) -> tuple[list[SyncSample], Windows]:
    """The samples of these answers; at the end one SYNC is left out, as the host does it."""
    windows, samples = Windows(), list[SyncSample]()
    due: list[list[MotionPdo | PositionPdo]] = [[] for _ in range(len(rows) + 2)]
    for k, (velocity, of_motion, of_place, turned) in enumerate(rows):
        pair = [
            (MotionPdo(1, 0x27, velocity, TORQUE + k), of_motion),
            (PositionPdo(1, POSITION + k, 0, velocity), of_place),
        ]
        for frame, fate in reversed(pair) if turned else pair:
            due[k + fate.late].extend([frame] * fate.copies)
    for k in range(len(rows) + 1):
        sample = windows.sync() if k < len(rows) else None
        if sample is not None:
            samples.append(sample)
        for frame in due[k]:
            (windows.motion if isinstance(frame, MotionPdo) else windows.position)(frame)  # pyright: ignore[reportArgumentType]
        if settled:
            windows.settle()
    last = windows.sync()
    return [*samples, *([] if last is None else [last])], windows


def mixed(samples: list[SyncSample]) -> list[SyncSample]:
    return [s for s in samples if s.torque - TORQUE != s.position - POSITION]


def moved(samples: list[SyncSample]) -> list[SyncSample]:
    """Given to another SYNC than it answers."""
    return [s for s in samples if s.torque - TORQUE != s.index]


ON_TIME, LOST, LATE, DOUBLE = Fate(), Fate(copies=0), Fate(late=1), Fate(copies=2)
fates = st.sampled_from([ON_TIME] * 6 + [LOST, LATE, DOUBLE])
any_rows = st.lists(st.tuples(st.integers(-2, 2), fates, fates, st.booleans()), min_size=1, max_size=40)


def on_time(velocities: list[int]) -> list[Row]:
    return [(velocity, ON_TIME, ON_TIME, False) for velocity in velocities]


def with_fate(rows: list[Row], at: int, motion: Fate = ON_TIME, place: Fate = ON_TIME) -> list[Row]:
    return [(v, motion, place, turned) if k == at else (v, m, p, turned) for k, (v, m, p, turned) in enumerate(rows)]


def test_every_answered_sync_is_a_sample_in_any_order_of_the_frames() -> None:
    rows = [(k % 3, ON_TIME, ON_TIME, k % 2 == 0) for k in range(20)]
    samples, windows = told(rows)
    assert [s.index for s in samples] == list(range(20))
    assert moved(samples) == mixed(samples) == []
    assert windows.doubt is None


@pytest.mark.parametrize("fate", [LOST, LATE, DOUBLE])
@pytest.mark.parametrize("which", ["motion", "place", "both"])
def test_one_mishap_costs_three_samples_at_most_and_all_others_are_right(fate: Fate, which: str) -> None:
    rows = on_time([k % 7 for k in range(30)])
    hit = {name: fate for name in ("motion", "place") if which in (name, "both")}
    samples, windows = told(with_fate(rows, 10, **hit))
    assert moved(samples) == []
    assert len(samples) >= 27
    assert windows.doubt is None
    assert all(a.index < b.index for a, b in pairwise(samples))


@given(any_rows)
@example([(0, LOST, ON_TIME, False), *on_time([1, 1]), (2, LATE, ON_TIME, False), *on_time([2, 3])])
def test_frames_of_one_tpdo_lost_or_late_never_mix_a_sample(rows: list[Row]) -> None:
    """However many, and whatever the velocities: TPDO1 suffers, TPDO2 is in step."""
    only_motion = [(v, m if m.copies < 2 else ON_TIME, ON_TIME, t) for v, m, _, t in rows]
    samples, _ = told(only_motion)
    assert moved(samples) == mixed(samples) == []


@given(st.lists(st.tuples(fates, fates, st.booleans()), min_size=1, max_size=40))
def test_whatever_happens_to_both_no_sample_is_mixed_while_the_axis_moves(
    happenings: list[tuple[Fate, Fate, bool]],
) -> None:
    """No two SYNCs that a mishap could confuse tell one velocity."""
    rows = [(k, motion, place, turned) for k, (motion, place, turned) in enumerate(happenings)]
    samples, _ = told(rows)
    assert mixed(samples) == []
    assert all(a.index < b.index for a, b in pairwise(samples))


@given(any_rows)
def test_where_the_host_waits_for_answers_lost_and_doubled_frames_do_no_harm(rows: list[Row]) -> None:
    never_late = [(v, Fate(copies=m.copies), Fate(copies=p.copies), t) for v, m, p, t in rows]
    samples, windows = told(never_late, settled=True)
    assert moved(samples) == mixed(samples) == []
    assert windows.doubt is None
    good = [k for k, (_, m, p, _) in enumerate(never_late) if m.copies == p.copies == 1]
    assert len(samples) >= len(good) - 2 * sum(2 in (m.copies, p.copies) for _, m, p, _ in never_late)


@pytest.mark.slow
@given(st.integers(1, 10), st.integers(2, 20), st.lists(st.integers(-3, 3), min_size=40, max_size=40), st.booleans())
def test_answers_that_are_all_late_for_a_while_are_found_out(
    since: int, long: int, velocities: list[int], to_the_end: bool
) -> None:
    until = len(velocities) if to_the_end else since + long
    rows = [
        (v, LATE, LATE, False) if since <= k < until else row
        for k, (v, row) in enumerate(zip(velocities, on_time(velocities), strict=True))
    ]
    samples, windows = told(rows)
    assert mixed(samples) == []
    if moved(samples):
        assert windows.doubt == f"answers to SYNC came a cycle late since sample {moved(samples)[0].index}"
