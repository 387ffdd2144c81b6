"""Finds drive adapters by entry point: a package with a ``sweepid.drives`` entry adds an adapter."""

from collections.abc import Callable, Mapping
from importlib.metadata import entry_points
from pathlib import Path
from typing import cast

from drivers.bounded_yaml import read_mapping
from drivers.errors import BadProfile
from drivers.ports import DrivePort

Factory = Callable[[Mapping[str, object], Path], DrivePort]


def load_profile(path: Path) -> dict[str, object]:
    """Read a drive profile from a YAML file. BadProfile names the file and the reason."""
    try:
        return dict(read_mapping(path, "adapter"))
    except BadProfile as error:
        raise BadProfile(f"{path}: {error}") from None


def open_profile(path: Path) -> tuple[dict[str, object], DrivePort]:
    """Content of a profile file, and its machine's port, not yet connected. BadProfile names file, place, reason."""
    profile = load_profile(path)
    try:
        return profile, open_drive(profile, path.parent)
    except BadProfile as error:
        raise BadProfile(f"{path}: {error}") from None


def open_drive(profile: Mapping[str, object], base: Path) -> DrivePort:
    """The port of a profile's machine, not yet connected. Files named in the profile are relative to `base`.

    Raises BadProfile if the key ``adapter`` does not name a registered adapter, or if the adapter refuses the
    profile.
    """
    adapters = {entry.name: entry for entry in entry_points(group="sweepid.drives")}
    name = profile.get("adapter")
    if not isinstance(name, str) or name not in adapters:
        raise BadProfile(f"adapter: {name!r} is unknown; installed: {', '.join(sorted(adapters)) or 'none'}")
    factory = cast("Factory", adapters[name].load())
    return factory(profile, base)
