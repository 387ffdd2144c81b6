"""The mapping of a trace that has none: from the few things that its file cannot know, and as text to be edited."""

from pathlib import Path
from typing import Any

import yaml
from pydantic import ValidationError

from service.formats.traces.mapping import Mapping, SingleAxis
from service.formats.traces.trace_import import Imported, of_file
from service.model.configuration import bad_field, read_yaml


def mapping_of(
    path: Path,
    *,
    axis: str | None = None,
    torque_constant: float | None = None,
    sample_rate: float | None = None,
    **known: Any,
) -> Mapping:
    """A mapping file (YAML), or the mapping of a trace file; `known`: fields of the axis. BadInput names the field."""
    if path.suffix.lower() in (".yaml", ".yml"):
        return read_yaml(path, Mapping)
    given = {name: value for name, value in known.items() if value is not None}
    name = "".join(letter for letter in path.stem if letter.isprintable())[:200] or "trace"
    try:
        mapping = of_file(path, SingleAxis(name=name, joint="axis", **given), axis, torque_constant)
        if sample_rate is None:
            return mapping
        return mapping.model_copy(
            update={
                "sweeps": tuple(
                    one.model_validate(one.model_dump(exclude_unset=True) | {"sample_rate": sample_rate})
                    for one in mapping.sweeps
                )
            }
        )
    except ValidationError as error:
        raise bad_field(str(path), error) from None


def mapping_text(made: Imported) -> str:
    """The whole mapping as YAML, with the guesses as comments."""
    content = made.mapping.model_dump(mode="json", exclude_defaults=True)
    content["robot"] = made.mapping.model_dump(mode="json", exclude_none=True)["robot"]
    notes = "".join(f"# {note}\n" for note in made.notes)
    return notes + yaml.safe_dump(content, sort_keys=False, allow_unicode=True)
