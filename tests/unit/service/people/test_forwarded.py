"""Whose word counts for where a request came from: `X-Forwarded-For` over real HTTP, and what the audit has."""

from pathlib import Path

import pytest

from tests.unit.service.api.conftest import serving
from tests.unit.service.people.conftest import calling

pytestmark = pytest.mark.slow

CLAIMED = "203.0.113.9"
HERE = "127.0.0.1"


@pytest.mark.parametrize(
    ("settings", "caller", "counts"),
    [
        ({}, HERE, HERE),
        ({"trusted_proxies": [HERE]}, HERE, HERE),  # without `behind_proxy` the list means nothing
        ({"behind_proxy": True}, HERE, CLAIMED),
        ({"behind_proxy": True}, "127.0.0.2", "127.0.0.2"),
        ({"behind_proxy": True, "trusted_proxies": ["127.0.0.2/32", "10.0.0.0/8"]}, "127.0.0.2", CLAIMED),
        ({"behind_proxy": True, "trusted_proxies": ["10.0.0.0/8"]}, HERE, HERE),
    ],
)
def test_only_a_trusted_proxy_tells_who_asks(
    tmp_path: Path,
    profile: Path,
    monkeypatch: pytest.MonkeyPatch,
    settings: dict[str, object],
    caller: str,
    counts: str,
) -> None:
    monkeypatch.setenv("FORWARDED_ALLOW_IPS", "*")  # which uvicorn reads where nobody tells it
    with serving(tmp_path, profile, **settings) as url, calling(url, None, caller) as http:
        answer = http.post("/api/v1/campaigns", json={"plan_id": 5}, headers={"X-Forwarded-For": CLAIMED})
        assert answer.status_code == 404
        entries = [one["entry"] for one in http.get("/api/v1/audit").json()["items"]]
    assert [entry["address"] for entry in entries] == [counts, counts]  # request and outcome
