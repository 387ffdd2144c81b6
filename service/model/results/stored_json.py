"""JSON that is returned unchanged from the store, and its type."""

from dataclasses import dataclass
from typing import Any

from pydantic import GetJsonSchemaHandler, TypeAdapter
from pydantic.json_schema import JsonSchemaValue
from pydantic_core import CoreSchema


@dataclass(frozen=True)
class JsonOf:
    """Annotates a JSON object: its schema is that of a model (or a union of models), its content is not validated."""

    model: Any  # whatever a TypeAdapter takes

    def __get_pydantic_json_schema__(self, _: CoreSchema, handler: GetJsonSchemaHandler) -> JsonSchemaValue:
        return handler(TypeAdapter(self.model).core_schema)
