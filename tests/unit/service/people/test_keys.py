"""Keys in wrong places are masked, whole or cut off."""

import pytest

from service.people.keys import key_sha256, masked, new_key

KEY = f"sweepid-{'0123456789abcdef' * 4}"  # a fixed one: the processes of a run must agree on the names of tests


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        (KEY, "sweepid-(key)"),
        (f"Anna {KEY} smoke", "Anna sweepid-(key) smoke"),
        (KEY[:-1], "sweepid-(key)"),  # cut off by the limit of a field
        (f"{KEY}0", "sweepid-(key)"),
        (f"{KEY},{KEY}", "sweepid-(key),sweepid-(key)"),
        ("sweepid-0.2.0", "sweepid-0.2.0"),
        ("sweepid-diagnosis of 2026", "sweepid-diagnosis of 2026"),
    ],
)
def test_a_key_is_masked(text: str, expected: str) -> None:
    assert masked(text) == expected


def test_only_a_whole_key_has_a_hash() -> None:
    assert None not in (key_sha256(KEY), key_sha256(new_key()))
    assert [key_sha256(wrong) for wrong in (KEY[:-1], f"{KEY}0", f" {KEY}")] == [None] * 3
