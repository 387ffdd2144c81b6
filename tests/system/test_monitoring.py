"""The configuration of the monitoring: a real Prometheus scrapes a real service, and answers every query of ours."""

import json
import re
import shutil
import subprocess
from http import HTTPStatus
from pathlib import Path

import httpx
import pytest
import yaml

from service.web.api.metrics import GROUPS
from tests.ports import free_port
from tests.programs import needs
from tests.system.rest_bench import PATIENT_LEASE, serving, until, virtual_machine

pytestmark = pytest.mark.slow

FOLDER = Path(__file__).parents[2] / "config" / "monitoring"
NAMES = {f"{figure.name}_total" if figure.counter else figure.name for figures in GROUPS.values() for figure in figures}


def queries() -> list[str]:
    """Of the dashboard and of the alerts."""
    dashboard = json.loads((FOLDER / "grafana" / "sweepid-plant.json").read_text("utf-8"))
    found = [target["expr"] for panel in dashboard["panels"] for target in panel["targets"]]
    rules = yaml.safe_load((FOLDER / "alerts.yml").read_text("utf-8"))
    return found + [rule["expr"] for group in rules["groups"] for rule in group["rules"]]


def test_every_query_names_metrics_that_there_are() -> None:
    named = {name for query in queries() for name in re.findall(r"sweepid_[a-z_]+", query)}
    assert len(named) > 15
    assert named - NAMES == set()


def test_the_dashboard_uses_the_provisioned_source() -> None:
    sources = yaml.safe_load((FOLDER / "grafana" / "datasource.yml").read_text("utf-8"))["datasources"]
    dashboard = json.loads((FOLDER / "grafana" / "sweepid-plant.json").read_text("utf-8"))
    assert {panel["datasource"]["uid"] for panel in dashboard["panels"]} == {source["uid"] for source in sources}


@needs("prometheus")
def test_a_real_prometheus_scrapes_a_service_and_answers(tmp_path: Path) -> None:
    configuration = yaml.safe_load((FOLDER / "prometheus.yml").read_text("utf-8"))
    shutil.copy(FOLDER / "alerts.yml", tmp_path)
    port = free_port()
    with (
        virtual_machine(tmp_path) as machine,
        serving(tmp_path, machine.profile, PATIENT_LEASE) as service,
    ):
        configuration["global"]["scrape_interval"] = "1s"
        configuration["scrape_configs"][0]["static_configs"][0]["targets"] = [service.url.removeprefix("http://")]
        changed = tmp_path / "prometheus.yml"
        changed.write_text(yaml.safe_dump(configuration), "utf-8")
        for each in (FOLDER / "prometheus.yml", changed):
            subprocess.run(["promtool", "check", "config", str(each)], check=True, capture_output=True, timeout=60)
        command = ["prometheus", f"--config.file={changed}", f"--storage.tsdb.path={tmp_path / 'tsdb'}"]
        with (
            subprocess.Popen(
                [*command, f"--web.listen-address=127.0.0.1:{port}"],
                stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL,
            ) as prometheus,
            httpx.Client(base_url=f"http://127.0.0.1:{port}/api/v1", timeout=60, trust_env=False) as http,
        ):
            try:

                def answer(query: str) -> list:
                    try:
                        got = http.get("/query", params={"query": query})
                    except httpx.TransportError:
                        return []  # not started yet
                    if got.status_code == HTTPStatus.SERVICE_UNAVAILABLE:
                        return []  # it listens, and reads its storage
                    said = got.json()
                    assert said["status"] == "success", said
                    return said["data"]["result"]

                until(lambda: answer("sweepid_machine_connected == 1"), "the machine's state is scraped")
                for query in queries():
                    answer(query)  # it is one that Prometheus understands
                until(lambda: answer("rate(sweepid_bus_frames_total[1m]) > 0"), "the traffic of the bus is known")
                rules = http.get("/rules").json()["data"]["groups"][0]["rules"]
                assert {rule["health"] for rule in rules} <= {"ok", "unknown"}
                assert len(rules) == 11
            finally:
                prometheus.terminate()
