"""A Dask scheduler and its workers as processes of their own, with mutual TLS and certificates made by OpenSSL."""

import os
import socket
import subprocess
import sys
import time
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path

from service.process.settings import Certificates, Cluster
from tests.ports import free_port

CONFIG = Path(__file__).parents[3] / "config" / "dask"


def certificates(folder: Path, name: str) -> Certificates:
    """An authority and a certificate that it signed."""
    folder.mkdir(exist_ok=True)
    ca, ca_key, pem, key, request = (folder / f"{name}{end}" for end in ("-ca.pem", "-ca.key", ".pem", ".key", ".csr"))
    new = ["-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:prime256v1", "-nodes"]
    _openssl("req", "-x509", *new, "-days", "2", "-subj", f"/CN={name} authority", "-out", ca, "-keyout", ca_key)
    _openssl("req", *new, "-subj", f"/CN={name}", "-out", request, "-keyout", key)
    _openssl("x509", "-req", "-in", request, "-CA", ca, "-CAkey", ca_key, "-CAcreateserial", "-days", "2", "-out", pem)
    return Certificates(ca, pem, key)


def _openssl(*words: str | Path) -> None:
    subprocess.run(["openssl", *map(str, words)], check=True, capture_output=True)


@dataclass
class DaskProcesses:
    """Started with `config/dask`, as the how-to says; each may be killed and started again."""

    folder: Path
    files: Certificates
    port: int
    scheduler: subprocess.Popen[bytes] | None = None
    workers: list[subprocess.Popen[bytes]] = field(default_factory=list)

    @classmethod
    def at_free_port(cls, folder: Path, files: Certificates) -> "DaskProcesses":
        return cls(folder, files, free_port())

    @property
    def cluster(self) -> Cluster:
        return Cluster(f"tls://127.0.0.1:{self.port}", self.files)

    def start_scheduler(self) -> None:
        """Returns when it listens."""
        self.scheduler = self._start(
            ["scheduler", "--host", "127.0.0.1", "--protocol", "tls", "--port", str(self.port), "--no-dashboard"]
        )
        while True:
            with suppress(ConnectionRefusedError), socket.create_connection(("127.0.0.1", self.port)):
                return
            assert self.scheduler.poll() is None, (self.folder / "dask.log").read_text("utf-8")
            time.sleep(0.05)

    def start_worker(self) -> None:
        words = ["worker", self.cluster.scheduler, "--nthreads", "1", "--no-nanny", "--no-dashboard"]
        self.workers.append(
            self._start(
                [*words, "--death-timeout", "120", "--local-directory", str(self.folder), "--host", "127.0.0.1"]
            )
        )

    def close(self) -> None:
        processes = [*self.workers, *([] if self.scheduler is None else [self.scheduler])]
        for process in processes:
            process.kill()
        for process in processes:
            process.wait(60)

    def _start(self, words: Sequence[str]) -> subprocess.Popen[bytes]:
        files = self.files
        tls = ["--tls-ca-file", str(files.authority), "--tls-cert", str(files.certificate), "--tls-key", str(files.key)]
        environment = os.environ | {"DASK_CONFIG": str(CONFIG), "OPENBLAS_NUM_THREADS": "1"}
        command = [sys.executable, "-m", "dask", *words, *tls]
        with (self.folder / "dask.log").open("ab") as log:
            return subprocess.Popen(command, stdout=log, stderr=log, env=environment)
