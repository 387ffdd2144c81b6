"""Which host names the service answers to, wherever it listens: the check that DNS rebinding runs into."""

from pathlib import Path

import httpx
import pytest
import yaml

from service.process.settings import Settings
from service.web.app import create_app

LOOPBACK = {"127.0.0.1", "localhost", "::1"}


@pytest.mark.parametrize(
    ("host", "allowed", "names"),
    [
        ("127.0.0.1", (), LOOPBACK),
        ("localhost", ("cell7.example",), LOOPBACK | {"cell7.example"}),
        ("0.0.0.0", ("Cell7.Example", "fd00::7"), LOOPBACK | {"0.0.0.0", "cell7.example", "fd00::7"}),
        ("192.168.4.7", ("cell7",), LOOPBACK | {"192.168.4.7", "cell7"}),
        ("0.0.0.0", (), set[str]()),  # any
    ],
)
def test_names(host: str, allowed: tuple[str, ...], names: set[str]) -> None:
    assert set(Settings(host=host, allowed_hosts=allowed).answers_to) == names


@pytest.mark.slow
@pytest.mark.parametrize(
    ("host", "answered"),
    [("127.0.0.1:8642", True), ("CELL7.example", True), ("evil.example:8642", False), ("", False)],
)
async def test_a_service_on_every_address_answers_to_its_names_alone(host: str, answered: bool) -> None:
    settings = Settings(host="0.0.0.0", allowed_hosts=("cell7.example",))
    transport = httpx.ASGITransport(app=create_app(settings, settings.answers_to))
    async with httpx.AsyncClient(transport=transport, base_url="http://127.0.0.1") as http:
        answer = await http.get("/api/v1/openapi.json", headers={"Host": host})
    assert (answer.status_code, host in answer.text) == ((200, False) if answered else (403, True))


def test_the_cell_of_docker_compose_answers_to_names(root: Path) -> None:
    service = yaml.safe_load((root / "docker-compose.yml").read_text())["services"]["service"]
    assert "0.0.0.0" in service["command"]
    default = '["localhost"]'
    assert service["environment"]["SWEEPID_ALLOWED_HOSTS"] == f"${{SWEEPID_ALLOWED_HOSTS:-{default}}}"
    # nobody is asked who he is: the port is published on this computer alone, or by a login
    published = yaml.safe_load((root / "docker-compose.yml").read_text())["services"]["machine"]["ports"]
    assert all(port.startswith("127.0.0.1:") for port in published)
    assert service["environment"]["SWEEPID_TRUSTED_NETWORK"] == "true"
