"""The committed OpenAPI document is the one that the routes make."""

from service.api.openapi import COMMITTED, document


def test_the_committed_document_is_not_stale() -> None:
    assert COMMITTED.read_text(encoding="utf-8") == document(), "run: python -m service.api.openapi"
