"""JSON that is handed on as it was stored, and what it is."""

from dataclasses import dataclass
from typing import Any

from pydantic import GetJsonSchemaHandler, TypeAdapter
from pydantic.json_schema import JsonSchemaValue
from pydantic_core import CoreSchema


@dataclass(frozen=True)
class JsonOf:
    """Annotates a JSON object: its schema is that of a model (or a union of models), its content goes by untouched."""

    model: Any  # whatever a TypeAdapter takes

    def __get_pydantic_json_schema__(self, _: CoreSchema, handler: GetJsonSchemaHandler) -> JsonSchemaValue:
        return handler(TypeAdapter(self.model).core_schema)
