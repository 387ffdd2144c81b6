"""The committed OpenAPI document is the one that the routes make."""

import pytest

from service.api.openapi import COMMITTED, document

pytestmark = pytest.mark.slow


def test_the_committed_document_is_not_stale() -> None:
    assert COMMITTED.read_text(encoding="utf-8") == document(), "run: python -m service.api.openapi"
