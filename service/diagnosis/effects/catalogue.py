"""The shipped effects and, behind them, those that installed packages bring by an entry point ``sweepid.effects``."""

from collections.abc import Iterable, Iterator, Mapping
from functools import cached_property
from importlib.metadata import EntryPoint, entry_points

from service.diagnosis.effects.effect import Effect
from service.errors import BadInput

GROUP = "sweepid.effects"


class Catalogue(Mapping[str, Effect]):
    """Effects by name: the shipped ones in their order, then the others by name.

    Installed packages are asked at the first look, not at import: theirs import this one, in whichever order. Until all
    of them can be used, every look is a BadInput that names package and entry point.
    """

    def __init__(self, shipped: Iterable[Effect]) -> None:
        self._shipped = {effect.name: effect for effect in shipped}

    def __getitem__(self, name: str) -> Effect:
        return self._all[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._all)

    def __len__(self) -> int:
        return len(self._all)

    @property
    def brought(self) -> dict[str, str]:
        """The effects that are not shipped, and from which package each is."""
        return {entry.name: _package(entry) for entry in _entries() if entry.name in self._all}

    @cached_property
    def _all(self) -> dict[str, Effect]:
        effects, owners = dict(self._shipped), dict.fromkeys(self._shipped, "sweepid")
        for entry in _entries():
            if entry.name in owners:
                raise BadInput(_place(entry), f"an effect of this name comes with {owners[entry.name]} already")
            effects[entry.name], owners[entry.name] = _loaded(entry), _package(entry)
        return effects


def _entries() -> list[EntryPoint]:
    return sorted(entry_points(group=GROUP), key=lambda entry: (entry.name, _package(entry)))


def _loaded(entry: EntryPoint) -> Effect:
    try:
        effect = entry.load()
    except Exception as error:  # whatever a foreign module does while it is imported
        raise BadInput(_place(entry), f"cannot be loaded: {type(error).__name__}: {error}") from error
    if not isinstance(effect, Effect):
        raise BadInput(_place(entry), f"is {type(effect).__name__}, not service.diagnosis.effects.effect.Effect")
    if effect.name != entry.name:
        raise BadInput(_place(entry), f"its effect calls itself {effect.name!r}: both must have the same name")
    return effect


def _place(entry: EntryPoint) -> str:
    return f"package {_package(entry)}, entry point {GROUP}: {entry.name} = {entry.value}"


def _package(entry: EntryPoint) -> str:
    return "without a name" if entry.dist is None else f"{entry.dist.name} {entry.dist.version}"
