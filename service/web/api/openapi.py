"""Writes the committed OpenAPI document: ``python -m service.web.api.openapi`` (a test fails if it is out of date)."""

import json
from pathlib import Path

from service.process.settings import Settings
from service.web.app import create_app

COMMITTED = Path(__file__).parents[3] / "docs" / "reference" / "openapi.json"


def document() -> str:
    """The document as JSON text; needs neither an application nor a machine."""
    return json.dumps(create_app(Settings()).openapi(), indent=2, ensure_ascii=False) + "\n"


if __name__ == "__main__":
    COMMITTED.write_text(document(), encoding="utf-8")
