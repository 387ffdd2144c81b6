"""Requirements of a test on its bench. A pytest mark would have to be registered by the user of the suite."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import TypeVar

from drivers.contract.bench import Bench
from drivers.ports import SweepMode

Test = TypeVar("Test", bound=Callable[..., object])

_NAME = "contract_needs"


@dataclass(frozen=True, slots=True)
class Needs:
    """See `needs`."""

    modes: frozenset[SweepMode] = frozenset()
    orders: frozenset[str] = frozenset()
    injects: bool | None = None
    exclusive: bool | None = None
    load_encoder: bool = False
    other: bool = False
    missing: bool = False


def needs(
    *,
    modes: Iterable[SweepMode] = (),
    orders: Iterable[str] = (),
    injects: bool | None = None,
    exclusive: bool | None = None,
    load_encoder: bool = False,
    other: bool = False,
    missing: bool = False,
) -> Callable[[Test], Test]:
    """Marks a test that needs these sweep modes and orders, a drive with or without torque noise, a bus for one host or
    for several, a load encoder, a second axis.

    `missing`: a test over the fixture `mode` covers a mode that the bench does not have.
    """
    wanted = Needs(frozenset(modes), frozenset(orders), injects, exclusive, load_encoder, other, missing)

    def mark(test: Test) -> Test:
        setattr(test, _NAME, wanted)
        return test

    return mark


def lacking(test: object, bench: Bench, mode: SweepMode | None) -> str:
    """What the bench lacks for a test, including `mode` if it is given; "" if nothing."""
    wanted: Needs = getattr(test, _NAME, Needs())
    if mode is not None and (mode in bench.modes) is wanted.missing:
        return f"it has {'' if wanted.missing else 'no '}sweep mode {mode.value}"
    if absent := sorted(each.value for each in wanted.modes - bench.modes):
        return f"it has no sweep mode {', '.join(absent)}"
    if absent := sorted(wanted.orders - bench.orders):
        return f"it takes no order {', '.join(absent)}"
    if wanted.injects not in (None, bench.injects):
        return f"it makes {'' if bench.injects else 'no '}torque noise"
    if wanted.exclusive not in (None, bench.exclusive):
        return f"it takes {'one host' if bench.exclusive else 'several hosts'} at a time"
    if wanted.load_encoder and not bench.load_encoder:
        return "it has no load encoder"
    return "it has no second axis" if wanted.other and bench.other is None else ""
