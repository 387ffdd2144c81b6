"""Finds drive adapters by entry point: whoever installs a package with a ``sweepid.drives`` entry brings a drive."""

from collections.abc import Callable, Mapping
from importlib.metadata import entry_points
from pathlib import Path
from typing import cast

from drivers.errors import BadProfile
from drivers.ports import DrivePort
from drivers.yaml_file import read_mapping

GROUP = "sweepid.drives"

Factory = Callable[[Mapping[str, object], Path], DrivePort]


def load_profile(path: Path) -> dict[str, object]:
    """A drive profile from a YAML file; BadProfile names the file and the reason."""
    try:
        return dict(read_mapping(path, "adapter"))
    except BadProfile as error:
        raise BadProfile(f"{path}: {error}") from None


def open_drive(profile: Mapping[str, object], base: Path) -> DrivePort:
    """The port of a profile's machine, not yet connected. Files named in the profile are relative to `base`.

    BadProfile if the key ``adapter`` names no registered adapter, or the adapter refuses the profile.
    """
    adapters = {entry.name: entry for entry in entry_points(group=GROUP)}
    name = profile.get("adapter")
    if not isinstance(name, str) or name not in adapters:
        raise BadProfile(f"adapter: {name!r} is not known; installed are {', '.join(sorted(adapters)) or 'none'}")
    factory = cast("Factory", adapters[name].load())
    return factory(profile, base)
