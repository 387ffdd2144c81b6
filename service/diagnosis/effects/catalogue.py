"""The effects of sweepid, followed by those that installed packages add with the entry point ``sweepid.effects``."""

from collections.abc import Iterable, Iterator, Mapping
from functools import cached_property
from importlib.metadata import EntryPoint, entry_points

from service.diagnosis.effects.effect import Effect
from service.model.errors import BadInput

GROUP = "sweepid.effects"


class Catalogue(Mapping[str, Effect]):
    """Effects by name: those of sweepid in their order, then the others in alphabetical order.

    Entry points are loaded at the first access, not at import, because the packages import this module. If one
    cannot be used, each access raises BadInput with the names of the package and the entry point.
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
        """The effects of other packages, with the name of the package of each."""
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
    except Exception as error:  # a foreign module may raise any exception during its import
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
