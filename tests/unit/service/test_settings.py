"""Settings and other files that somebody else wrote: looked at before they are believed."""

from pathlib import Path

import httpx
import pytest
import yaml

from drivers.bounded_yaml import BoundedLoader
from service import BadInput
from service.model.configuration import LARGEST_YAML, Cell, read_text, read_yaml
from service.process.settings import Settings, load_settings
from service.web.app import create_app


def test_the_shipped_file_gives_the_defaults(root: Path) -> None:
    assert load_settings(root / "config/service.yaml") == Settings()


def test_the_environment_stands_above_the_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file = tmp_path / "service.yaml"
    file.write_text("port: 1000\nhost: 0.0.0.0\n")
    monkeypatch.setenv("SWEEPID_PORT", "2000")
    monkeypatch.setenv("SWEEPID_ALLOWED_HOSTS", '["cell7.example"]')
    settings = load_settings(file)
    assert (settings.port, settings.host) == (2000, "0.0.0.0")
    assert "cell7.example" in settings.answers_to


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("lease_tiem: 5", "lease_tiem: unknown key; did you mean lease_time?"),
        ("lease_time: 0", "lease_time: Input should be greater than or equal to 0.5, got 0"),
        ("port: 70000", "port: Input should be less than or equal to 65535, got 70000"),
        ("port: [", "not YAML"),
        *((f"allowed_hosts: ['{name}']", "allowed_hosts.0") for name in ("http://cell7", "cell7:8642", "*", "")),
        *(
            (f"cors_origins: ['{origin}']", "cors_origins.0")
            for origin in ("*", "https://*.example", "cell7.example", "https://cell7.example/", "")
        ),
        *((f"trusted_proxies: ['{wrong}']", "trusted_proxies") for wrong in ("*", "10.0.0.1/8", "proxy.example")),
        ("trusted_proxies: []", "trusted_proxies"),
    ],
)
def test_a_bad_file_is_refused_with_field_and_value(tmp_path: Path, text: str, reason: str) -> None:
    file = tmp_path / "service.yaml"
    file.write_text(text)
    with pytest.raises(BadInput) as refused:
        load_settings(file)
    assert reason in str(refused.value)
    assert str(file) in str(refused.value)
    with pytest.raises(BadInput, match="cannot be read"):
        load_settings(tmp_path / "none.yaml")


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
async def test_a_service_on_every_address_answers_to_its_names_alone() -> None:
    """The check that DNS rebinding runs into."""
    settings = Settings(host="0.0.0.0", allowed_hosts=("cell7.example",))
    transport = httpx.ASGITransport(app=create_app(settings, settings.answers_to))
    async with httpx.AsyncClient(transport=transport, base_url="http://127.0.0.1") as http:
        for host, status in (("127.0.0.1:8642", 200), ("CELL7.example", 200), ("evil.example:8642", 403), ("", 403)):
            answer = await http.get("/api/v1/openapi.json", headers={"Host": host})
            assert (answer.status_code, host in answer.text) == (status, status == 403), host


def test_the_cell_of_docker_compose_answers_to_names(root: Path) -> None:
    services = yaml.safe_load((root / "docker-compose.yml").read_text())["services"]
    service = services["service"]
    assert "0.0.0.0" in service["command"]
    default = '["localhost"]'
    assert service["environment"]["SWEEPID_ALLOWED_HOSTS"] == f"${{SWEEPID_ALLOWED_HOSTS:-{default}}}"
    # nobody is asked who he is: the port is published on this computer alone, or by a login
    assert all(port.startswith("127.0.0.1:") for port in services["machine"]["ports"])
    assert service["environment"]["SWEEPID_TRUSTED_NETWORK"] == "true"


@pytest.mark.parametrize("host", ["0.0.0.0", "::", "", "192.168.4.7", "cell7", "127.0.0.1.example"])
def test_beyond_this_computer_somebody_asks_who_it_is(host: str) -> None:
    for login, told in ((False, "login: true.*trusted_network: true"), (True, "tls_certificate.*behind_proxy")):
        with pytest.raises(BadInput, match=f"(?s)^host: .*{told}"):
            Settings(host=host, login=login).check_reach()
    Settings(host=host, trusted_network=True).check_reach()
    Settings(host=host, login=True, behind_proxy=True).check_reach()
    Settings(host=host, login=True, tls_certificate=Path("a"), tls_key=Path("b")).check_reach()
    for this_computer in ("127.0.0.1", "127.8.8.8", "::1", "localhost"):
        Settings(host=this_computer).check_reach()


@pytest.mark.parametrize(
    ("values", "told"),
    [
        ({"tls_certificate": "a.pem"}, "^tls_key: is missing"),
        ({"tls_key": "a.key"}, "^tls_certificate: is missing"),
        ({"tls_certificate": "a.pem", "tls_key": "a.key"}, "^tls_certificate: a.pem and a.key cannot be used"),
    ],
)
def test_tls_needs_two_files_that_can_be_used(values: dict[str, str], told: str) -> None:
    with pytest.raises(BadInput, match=told):
        Settings.model_validate(values).check_tls()
    Settings().check_tls()


@pytest.mark.parametrize(
    ("address", "files", "place", "reason"),
    [
        ("tcp://scheduler:8786", (), "dask_scheduler", "is not encrypted, and scheduler is not this computer"),
        ("tcp://192.168.1.4:8786", (), "dask_scheduler", "is not encrypted"),
        ("scheduler:8786", (), "dask_scheduler", "is not of the form tls://HOST:PORT"),
        ("tls://scheduler", (), "dask_scheduler", "is not of the form tls://HOST:PORT"),
        ("tls://scheduler:99999", (), "dask_scheduler", "is not an address"),
        ("tls://scheduler:8786", (), "dask_authority", "is missing"),
        ("tls://scheduler:8786", ("authority", "certificate"), "dask_key", "is missing"),
        ("tls://scheduler:8786", ("authority", "certificate", "key"), "dask_certificate", "cannot be used"),
        ("tcp://127.0.0.1:8786", ("authority",), "dask_authority", "is not encrypted; use tls://"),
        (None, ("key",), "dask_scheduler", "is missing: certificates for it are set"),
    ],
)
def test_a_cluster_that_cannot_be_used_safely_is_refused(
    tmp_path: Path, address: str | None, files: tuple[str, ...], place: str, reason: str
) -> None:
    given = {f"dask_{name}": str(tmp_path / f"{name}.pem") for name in files}
    with pytest.raises(BadInput, match=f"{place}.*{reason}"):
        Settings.model_validate({"dask_scheduler": address, **given}).check()


def test_a_cluster_on_this_computer_needs_no_certificates() -> None:
    found = Settings(dask_scheduler="tcp://127.0.0.1:8786").cluster
    assert found is not None
    assert (found.scheduler, found.certificates) == ("tcp://127.0.0.1:8786", None)
    assert Settings().cluster is None


ALIASES = f"aliases stand for more than {BoundedLoader.longest} characters"
LAUGHS = ["a0: &a0 [x, x, x, x, x, x, x, x, x]"]
LAUGHS += [f"a{n}: &a{n} [{', '.join([f'*a{n - 1}'] * 9)}]" for n in range(1, 10)]
DEEP = f"nested too deeply, limit {BoundedLoader.deepest} levels"


@pytest.mark.parametrize(
    ("content", "told"),
    [
        pytest.param("\n".join(LAUGHS), ALIASES, id="less than 600 bytes for more than a thousand million values"),
        pytest.param(f"name: &a {'n' * 100_000}\nboxes: [{', '.join(['*a'] * 100)}]\n", ALIASES, id="a long text"),
        *(
            (f"name: {value}", "not YAML: a value is not of its type")
            for value in ("2001-13-45", "!!int ''", "!!bool x", "!!timestamp x")
        ),
        pytest.param(f"name: {'9' * 5000}", "not YAML: a value is not of its type", id="a long number"),
        *(  # what it stands for has no end
            (content, r"alias \*a is inside of its own anchor in .* line 1")
            for content in ("&a {b: *a}", "x: &a [1, {y: [*a]}]", "x: &a {<<: *a}")
        ),
        *(
            pytest.param(opened * levels + "1" + closed * levels, told, id=f"{levels} times {opened}")
            for opened, closed in (("[", "]"), ("{a: ", "}"), ("- ", ""))
            for levels, told in (
                (BoundedLoader.deepest, "valid dictionary|unknown key"),
                (BoundedLoader.deepest + 1, DEEP),
                (100_000, DEEP),
            )
        ),
        pytest.param("#" * (LARGEST_YAML + 1), f"is larger than {LARGEST_YAML} bytes", id="large"),
        ("1: 2", "key 1 is not text"),
    ],
)
def test_what_was_made_to_harm_is_refused(content: str, told: str, tmp_path: Path) -> None:
    path = tmp_path / "cell.yaml"
    path.write_text(content, "utf-8")
    with pytest.raises(BadInput, match=told):
        read_yaml(path, Cell)
    with pytest.raises(BadInput, match="is larger than 3 bytes"):
        read_text(path, 3)


def test_a_few_aliases_are_fine(tmp_path: Path) -> None:
    path = tmp_path / "cell.yaml"
    path.write_text("name: &n workshop\nboxes:\n  - {name: *n, size: [1, 1, 1], center: [0, 0, 0]}\n", "utf-8")
    assert read_yaml(path, Cell).boxes[0].name == "workshop"
