"""The base of all models of results."""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, Self, cast

from pydantic import BaseModel, ConfigDict, GetJsonSchemaHandler, JsonValue, TypeAdapter, ValidationError
from pydantic.json_schema import JsonSchemaValue
from pydantic_core import CoreSchema

from service.model.errors import BadInput


class Part(BaseModel):
    """A part of a result. Keys without a field are kept; a field with a default is missing in older results."""

    model_config = ConfigDict(frozen=True, extra="allow")

    def as_json(self) -> dict[str, JsonValue]:
        """The fields that were read or set; missing keys stay missing."""
        return self.model_dump(mode="json", exclude_unset=True)

    def to_json(self, path: Path | str | None = None) -> str:
        """The JSON that the commands write, indented; also into a file. OSError where that cannot be written."""
        text = json.dumps(self.as_json(), indent=2, allow_nan=False)
        if path is not None:
            Path(path).write_bytes(f"{text}\n".encode())
        return text

    def with_nonempty(self, **fields: object) -> Self:
        """A copy with the fields that are not empty; an empty one stays missing in the JSON."""
        return self.model_copy(update={name: value for name, value in fields.items() if value})


class Document(Part):
    """A complete result as it is stored or written to a file.

    `VERSION` is the newest readable version. Documents without the key "version" have version 1; fields missing in old
    ones have a default in the model.
    """

    VERSION: ClassVar[int] = 1

    @classmethod
    def read(cls, document: object, place: str) -> Self:
        """From JSON. BadInput names place and field, also if a newer version wrote the document."""
        if isinstance(document, Mapping):
            version = cast("Mapping[str, object]", document).get("version", 1)
            if not isinstance(version, int) or not 1 <= version <= cls.VERSION:
                raise BadInput(
                    f"{place}.version",
                    f"{version!r} is newer than {cls.VERSION}, the newest that can be read: update sweepid",
                )
        try:
            return cls.model_validate(document)
        except ValidationError as error:
            first = error.errors(include_url=False)[0]
            where = ".".join(str(key) for key in (place, *first["loc"]))
            given = repr(first["input"])
            got = "" if len(given) > 60 or first["type"] == "missing" else f", got {given}"
            more = f" (and {error.error_count() - 1} more)" if error.error_count() > 1 else ""
            raise BadInput(where, f"{first['msg']}{got}{more}; use a file written by this version of sweepid") from None


@dataclass(frozen=True)
class JsonOf:
    """Annotates a JSON object: its schema is that of a model (or a union of models), its content is not validated."""

    model: Any  # whatever a TypeAdapter takes

    def __get_pydantic_json_schema__(self, _: CoreSchema, handler: GetJsonSchemaHandler) -> JsonSchemaValue:
        return handler(TypeAdapter(self.model).core_schema)
