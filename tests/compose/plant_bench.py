"""The profile `plant` of docker-compose.yml, with images made here: no image can be pulled where it is tested.

PostgreSQL and Prometheus are Debian's, the object store is moto's server, which asks for no key. Grafana cannot be had:
in its place is a container that does nothing, in which the test asks what Grafana would ask.
"""

import os
import subprocess
from pathlib import Path

import httpx

from service.web.client import ServiceClient
from tests.compose.bench import COMMAND, ROOT, Containers, ready
from tests.ports import free_port
from tests.system.rest_bench import PATIENT_LEASE, until

CELLS = ("cell-1", "cell-2")
MACHINES = ("machine-1", "machine-2")
START = 900.0  # s, on a busy computer
BUILD = 900.0  # s

_IMAGES = r"""
ARG BASE=python:3.11-slim-bookworm
FROM ${BASE} AS packages
RUN apt-get update -qq \
 && DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends -o Dpkg::Options::=--force-unsafe-io \
      postgresql prometheus >/dev/null \
 && useradd --uid 10001 --no-create-home sweepid
ENV PATH=/usr/lib/postgresql/15/bin:${PATH}

FROM packages AS database
# what the image of PostgreSQL does at its first start
RUN printf '%s\n' '#!/bin/sh' 'set -eu' \
    'if [ ! -s "$PGDATA/PG_VERSION" ]; then' \
    '  initdb -D "$PGDATA" -U postgres --pwfile="$POSTGRES_PASSWORD_FILE" -E UTF8 --auth-host=scram-sha-256' \
    '  echo "host all all all scram-sha-256" >>"$PGDATA/pg_hba.conf"' \
    '  pg_ctl -D "$PGDATA" -w -o "-c listen_addresses=" start' \
    '  for file in /docker-entrypoint-initdb.d/*.sql; do psql -v ON_ERROR_STOP=1 -U postgres -f "$file"; done' \
    '  pg_ctl -D "$PGDATA" -w stop' \
    'fi' \
    'exec postgres -D "$PGDATA" -c "listen_addresses=*"' >/start && chmod +x /start
ENTRYPOINT ["/start"]

FROM packages AS prometheus
ENTRYPOINT ["prometheus"]

FROM ${BASE} AS objects
COPY requirements.lock /
# the versions of the lock
RUN sed -n 's/^\([a-z0-9-]*\)\(\[[a-z0-9,-]*\]\)\{0,1\}==\([^ ]*\).*/\1==\3/p' requirements.lock >versions \
 && python3 -m venv /moto \
 && /moto/bin/pip install -q --no-cache-dir --disable-pip-version-check -c versions 'moto[s3]' flask flask-cors
# it keeps nothing, but where its keys are read and its data would be written is tried
RUN printf '%s\n' '#!/bin/sh' 'set -eu' 'grep -q accessKey /run/secrets/s3.json' 'touch /data/tried' \
    'exec /moto/bin/python -m moto.server -H 0.0.0.0 -p 8333' >/usr/local/bin/weed && chmod +x /usr/local/bin/weed

FROM ${BASE} AS grafana
ENTRYPOINT ["sleep", "infinity"]
"""


def build_images() -> dict[str, str]:
    """The settings of docker-compose.yml that name them."""
    settings: dict[str, str] = {}
    for name in ("database", "prometheus", "objects", "grafana"):
        command = ["docker", "build", "--quiet", "--tag", f"sweepid-test-{name}", "--target", name, "--file", "-", "."]
        for variable, option in (("SWEEPID_BASE", "--build-arg=BASE="), ("SWEEPID_BUILD_NETWORK", "--network=")):
            if variable in os.environ:
                command.append(option + os.environ[variable])
        done = subprocess.run(
            command, cwd=ROOT, input=_IMAGES.encode(), capture_output=True, timeout=BUILD, check=False
        )
        assert done.returncode == 0, (done.stdout + done.stderr).decode()[-4000:]
        settings[f"SWEEPID_{name.upper()}_IMAGE"] = f"sweepid-test-{name}"
    return settings


class Plant(Containers):
    """Two cells and what they share."""

    def __init__(self, folder: Path, images: dict[str, str]) -> None:
        secrets = folder / "secrets"
        subprocess.run([ROOT / "config/plant/make-secrets", secrets], check=True, timeout=COMMAND)
        ports = {name: free_port() for name in ("1", "2", "PLANT", "PROMETHEUS", "GRAFANA")}
        super().__init__(
            folder,
            "sweepid-test-plant",
            {"COMPOSE_PROFILES": "plant", "SWEEPID_SECRETS": str(secrets), "SWEEPID_LEASE_TIME": str(PATIENT_LEASE)}
            | {f"SWEEPID_PORT_{name}": str(port) for name, port in ports.items()}
            | {f"SWEEPID_STOP_PORT_{number}": str(free_port()) for number in (1, 2)}
            | images,
        )
        urls = {name: f"http://127.0.0.1:{port}" for name, port in ports.items()}
        self.url = {"cell-1": urls["1"], "cell-2": urls["2"], "plant": urls["PLANT"]}
        self.prometheus = urls["PROMETHEUS"]

    def up(self, workers: int) -> None:
        """The command of docs/how-to/run-a-plant.md; returns when both cells could measure."""
        self.compose("up", "--detach", "--no-build", "--scale", f"worker={workers}", patience=START)
        for url in self.url.values():
            with ServiceClient(url) as client:
                until(lambda client=client: ready(client), f"{url} is ready")

    def python(self, service: str, program: str, *arguments: str) -> str:
        """What a program prints in a container."""
        return self.compose("exec", "-T", service, "python3", "-c", program, *arguments)

    def metric(self, query: str) -> dict[str, str]:
        """Prometheus's answer, by instance."""
        said = httpx.get(f"{self.prometheus}/api/v1/query", params={"query": query}, trust_env=False, timeout=60)
        return {one["metric"]["instance"]: one["value"][1] for one in said.json()["data"]["result"]}
