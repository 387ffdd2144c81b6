"""The base of all models of results."""

from collections.abc import Mapping
from typing import ClassVar, Self, cast

from pydantic import BaseModel, ConfigDict, JsonValue, ValidationError

from service.errors import BadInput


class Part(BaseModel):
    """A piece of a result. Keys without a field are kept; a field with a default is one that older results lack."""

    model_config = ConfigDict(frozen=True, extra="allow")

    def as_json(self) -> dict[str, JsonValue]:
        """What was read or made: keys that were not there stay away."""
        return self.model_dump(mode="json", exclude_unset=True)


class Document(Part):
    """A whole result as it is stored or written to a file.

    `VERSION` is the newest that can be read. Documents without the key "version" are of the first; what older ones of
    it lack has a default in the model.
    """

    VERSION: ClassVar[int] = 1

    @classmethod
    def read(cls, document: object, place: str) -> Self:
        """From JSON. BadInput names place and field, also where a newer version wrote it."""
        if isinstance(document, Mapping):
            version = cast("Mapping[str, object]", document).get("version", 1)
            if not isinstance(version, int) or not 1 <= version <= cls.VERSION:
                raise BadInput(
                    f"{place}.version", f"{version!r} cannot be read, up to {cls.VERSION} can: update sweepid"
                )
        try:
            return cls.model_validate(document)
        except ValidationError as error:
            first = error.errors(include_url=False)[0]
            where = ".".join(str(key) for key in (place, *first["loc"]))
            more = f" (and {error.error_count() - 1} more)" if error.error_count() > 1 else ""
            raise BadInput(where, f"{first['msg']}{more}; give what this version of sweepid wrote") from None
