"""docker-compose.yml without an engine: its profiles, what it seals, its images, the secrets of the plant."""

import json
import os
import re
import stat
import subprocess
from pathlib import Path
from typing import Any

import pytest
import yaml

from service.process.settings import Settings, cluster_at
from service.store.objects import check_usable
from tests.programs import needs, require

pytestmark = pytest.mark.slow

PLANT = "config/plant"
MOVING = {"machine", "service", "machine-1", "machine-2", "cell-1", "cell-2"}
ONCE = {"permissions", "bucket"}
WITH_KEYS = ("cell-1", "cell-2", "plant")


@pytest.fixture(scope="module")
def services(root: Path) -> dict[str, dict[str, Any]]:
    return yaml.safe_load((root / "docker-compose.yml").read_text())["services"]


@pytest.fixture(scope="module")
def secrets(root: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    require("openssl")  # make-secrets makes certificates
    folder = tmp_path_factory.mktemp("plant") / "secrets"
    subprocess.run([root / PLANT / "make-secrets", folder], check=True, capture_output=True)
    return folder


@needs("docker-compose")
@pytest.mark.parametrize("profile", [[], ["--profile", "cell"], ["--profile", "plant"]])
def test_docker_compose_accepts_its_file(root: Path, profile: list[str]) -> None:
    environment = {name: value for name, value in os.environ.items() if not name.startswith(("COMPOSE_", "SWEEPID_"))}
    command = ["docker-compose", *profile, "config", "-q"]
    checked = subprocess.run(command, cwd=root, env=environment, capture_output=True, text=True)
    assert (checked.returncode, checked.stderr) == (0, "")


def test_without_a_profile_there_is_the_cell_alone_and_plant_starts_all_of_its_own(
    root: Path, services: dict[str, dict[str, Any]]
) -> None:
    assert (root / ".env").read_text() == "COMPOSE_PROFILES=cell\n"  # `--profile` takes its place
    assert {name for name, service in services.items() if service["profiles"] == ["cell"]} == {"machine", "service"}
    reached, left = set[str](), ["plant"]
    while left:
        name = left.pop()
        reached.add(name)
        left += [other for other in services[name].get("depends_on", {}) if other not in reached]
    assert reached == {name for name, service in services.items() if service["profiles"] == ["plant"]}


def test_images_are_pinned_and_can_be_replaced(services: dict[str, dict[str, Any]]) -> None:
    images = {name: str(service["image"]) for name, service in services.items() if service["image"] != "sweepid"}
    for name, image in images.items():
        assert re.fullmatch(rf"\$\{{SWEEPID_{name.upper()}_IMAGE:-[a-z/]+:v?\d+\.\d+(\.\d+)?(-[a-z]+)?\}}", image), (
            image
        )
    assert set(images) == {"database", "objects", "prometheus", "grafana"}


def test_every_container_is_sealed(services: dict[str, dict[str, Any]]) -> None:
    for name, service in services.items():
        assert (service["read_only"], service["cap_drop"]) == (True, ["ALL"]), name
        assert service["security_opt"] == ["no-new-privileges:true"], name
        assert "cap_add" not in service or name == "permissions"
        assert service["restart"] == ("no" if name in MOVING | ONCE else "unless-stopped"), name
        assert all(port.startswith("127.0.0.1:") for port in service.get("ports", [])), name


def test_the_monitoring_of_the_plant_is_of_its_services(root: Path, services: dict[str, dict[str, Any]]) -> None:
    """The files that the containers mount exist; Prometheus and Grafana ask addresses and sources that there are."""
    for service in services.values():
        for volume in service.get("volumes", []):
            if isinstance(volume, str) and volume.startswith("./"):
                assert (root / volume.split(":")[0]).is_file(), volume
    scraped = yaml.safe_load((root / PLANT / "prometheus.yml").read_text())["scrape_configs"]
    aliases = [services[name]["networks"]["default"]["aliases"][0] for name in ("machine-1", "machine-2")]
    assert scraped == [{"job_name": "sweepid", "static_configs": [{"targets": [f"{alias}:8642" for alias in aliases]}]}]
    for alias in aliases:  # the service answers to the name under which it is scraped
        assert f'"{alias}"' in services[alias]["environment"]["SWEEPID_ALLOWED_HOSTS"]
    (source,) = yaml.safe_load((root / PLANT / "datasource.yml").read_text())["datasources"]
    (alone,) = yaml.safe_load((root / "config/monitoring/grafana/datasource.yml").read_text())["datasources"]
    assert source == alone | {"url": "http://prometheus:9090"}
    dashboards = yaml.safe_load((root / "config/monitoring/grafana/dashboards.yml").read_text())
    folder = dashboards["providers"][0]["options"]["path"]
    assert any(f":{folder}/sweepid-plant.json:ro" in str(volume) for volume in services["grafana"]["volumes"])


def test_secrets_stay_out_of_git_and_of_the_image(root: Path) -> None:
    for name in (".gitignore", ".dockerignore"):
        assert f"{PLANT}/secrets*" in [line.lstrip("/") for line in (root / name).read_text().splitlines()]
    ignored = (root / ".dockerignore").read_text().splitlines()
    assert ignored.index(f"{PLANT}/secrets*") > ignored.index("!config")  # the last line that fits decides


def test_secrets_are_for_one_container_each(secrets: Path, services: dict[str, dict[str, Any]]) -> None:
    for path in [secrets, *secrets.rglob("*")]:
        assert stat.S_IMODE(path.stat().st_mode) == (0o700 if path.is_dir() else 0o600)
    assert list(secrets.rglob("authority.key")) == []  # nobody can sign another certificate
    for name, service in services.items():
        mounted = [
            volume["source"].removeprefix("${SWEEPID_SECRETS:-./config/plant/secrets}/")
            for volume in service.get("volumes", [])
            if isinstance(volume, dict) and volume["target"] == "/run/secrets"
        ]
        assert mounted == ([] if not mounted else ["cell-1" if name == "bucket" else name])
        assert all((secrets / folder).is_dir() for folder in mounted)
        texts = [str(value) for value in service.get("environment", {}).values()]
        named = [Path(text).name for text in texts if text.startswith("/run/secrets/")]
        assert all((secrets / mounted[0] / file).is_file() for file in named), name


def test_the_services_accept_the_secrets(secrets: Path, services: dict[str, dict[str, Any]]) -> None:
    known = json.loads((secrets / "objects" / "s3.json").read_text())["identities"][0]["credentials"][0]
    for name in WITH_KEYS:
        settings = {
            key.removeprefix("SWEEPID_").lower(): str(value).replace("/run/secrets", str(secrets / name))
            for key, value in services[name]["environment"].items()
            if "${" not in str(value)
        }
        made = Settings.model_validate(settings)
        assert made.cluster == cluster_at(
            "tls://scheduler:8786", made.dask_authority, made.dask_certificate, made.dask_key
        )
        assert made.recordings_store is not None
        check_usable(made.recordings_store)
        keys = (secrets / name / "object-store-key").read_text()
        assert known["accessKey"] in keys
        assert known["secretKey"] in keys
        password = (secrets / "database" / "sweepid-password").read_bytes()
        assert (secrets / name / "database-password").read_bytes() == password


def test_secrets_in_use_are_never_replaced(root: Path, secrets: Path) -> None:
    before = {path: path.read_bytes() for path in secrets.rglob("*") if path.is_file()}
    again = subprocess.run([root / PLANT / "make-secrets", secrets], capture_output=True, text=True, check=False)
    assert again.returncode == 1
    assert "in use" in again.stderr
    assert {path: path.read_bytes() for path in secrets.rglob("*") if path.is_file()} == before
