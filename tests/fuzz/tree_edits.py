"""Edits of YAML and JSON by what they hold: values of other types, keys that are gone, double or strange."""

import copy
import json
from random import Random
from typing import Any

import yaml

from tests.fuzz import values

_LOADER, _DUMPER = getattr(yaml, "CSafeLoader", yaml.SafeLoader), getattr(yaml, "CSafeDumper", yaml.SafeDumper)
_MARK = "RAW-PLACE"  # stands in the tree where text goes that no emitter would write


def edit_yaml(content: bytes, rng: Random) -> bytes:
    """ValueError or YAMLError where the content is no tree any more."""
    tree, raw = _edited(yaml.load(content.decode(), Loader=_LOADER), rng, values.YAML)
    text = yaml.dump(tree, Dumper=_DUMPER, sort_keys=False, allow_unicode=True, width=10_000)
    return _doubled(text.replace(_MARK, raw), rng).encode("utf-8", "surrogatepass")


def edit_json(content: bytes, rng: Random) -> bytes:
    """ValueError where the content is no tree any more."""
    tree, raw = _edited(json.loads(content), rng, values.JSON)
    text = json.dumps(tree, indent=1)
    return _doubled(text.replace(f'"{_MARK}"', raw), rng).encode("utf-8", "surrogatepass")


def _doubled(text: str, rng: Random) -> str:
    """Sometimes a line stands twice, and with it its key."""
    if rng.random() < 0.9:
        return text
    lines = text.splitlines(keepends=True)
    at = rng.randrange(len(lines))
    return "".join([*lines[: at + 1], lines[at], *lines[at + 1 :]])


def _edited(tree: Any, rng: Random, raw: tuple[str, ...]) -> tuple[Any, str]:
    """The tree with one edit, and the text for the mark in it."""
    tree = copy.deepcopy(tree)  # of aliases, one place alone is to change
    places = list(_places(tree))
    if not places:
        return rng.choice(values.PLAIN), ""
    holder, key = rng.choice(places)
    match rng.randrange(10):
        case 0 | 1 | 2:
            holder[key] = copy.deepcopy(rng.choice(values.PLAIN))
        case 3 | 4 | 5:
            holder[key] = _MARK
        case 6:
            del holder[key]
        case 7:
            holder[key] = _turned(holder[key])
        case 8 if isinstance(holder, dict):
            holder[rng.choice(("x", "", values.LONG, "a.b", "\x07", 1, None, True))] = holder.pop(key)
        case 8:
            holder.insert(key, copy.deepcopy(holder[key]))
        case _:
            other_holder, other = rng.choice(places)
            holder[key] = copy.deepcopy(other_holder[other])
    return tree, rng.choice(raw)


def _turned(value: Any) -> Any:
    """The same as another type, or a number beside it."""
    match value:
        case bool() | None:
            return "no"
        case int() | float():
            return -value
        case str():
            return [value]
        case list():
            return {str(number): part for number, part in enumerate(value)}
        case _:
            return list(value)


def _places(tree: Any) -> Any:
    """(holder, key) of every value inside."""
    keys = list(tree) if isinstance(tree, dict) else range(len(tree)) if isinstance(tree, list) else ()
    for key in keys:
        yield tree, key
        yield from _places(tree[key])
