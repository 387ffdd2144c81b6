"""Whose word counts for where a request came from: `X-Forwarded-For` over real HTTP, and what the audit has."""

from collections.abc import Iterator
from pathlib import Path

import pytest

from service.process.settings import Settings
from tests.unit.service.api.conftest import serving
from tests.unit.service.people.conftest import calling

pytestmark = pytest.mark.slow

CLAIMED, HERE, PROXY = "203.0.113.9", "127.0.0.1", "127.0.0.2"
BEHIND: dict[str, dict[str, object]] = {
    "no": {"trusted_proxies": [PROXY]},  # without `behind_proxy` the list means nothing
    "yes": {"behind_proxy": True, "trusted_proxies": [f"{PROXY}/32", "10.0.0.0/8"]},
}


@pytest.fixture(scope="module", params=BEHIND)
def service(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory, profile: Path) -> Iterator[str]:
    with pytest.MonkeyPatch.context() as environment:
        environment.setenv("FORWARDED_ALLOW_IPS", "*")  # which uvicorn reads where nobody tells it
        with serving(tmp_path_factory.mktemp("proxy"), profile, **BEHIND[request.param]) as url:
            yield url


def test_only_a_trusted_proxy_tells_who_asks(service: str, request: pytest.FixtureRequest) -> None:
    for caller in (HERE, PROXY):
        with calling(service, None, caller) as http:
            answer = http.post("/api/v1/campaigns", json={"plan_id": 5}, headers={"X-Forwarded-For": CLAIMED})
            assert answer.status_code == 404
            newest = http.get("/api/v1/audit", params={"newest": True, "limit": 2}).json()["items"]
        trusted = caller == PROXY and "[yes]" in request.node.name
        assert [one["entry"]["address"] for one in newest] == [CLAIMED if trusted else caller] * 2


def test_by_default_the_proxy_is_on_this_computer() -> None:
    assert {str(network) for network in Settings(behind_proxy=True).trusted_proxies} == {f"{HERE}/32", "::1/128"}
