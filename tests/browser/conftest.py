"""What most of these tests look at: the page of a real service with the virtual machine, in real time, behind it."""

from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import pytest
from playwright.sync_api import Page

from service.web.client import ServiceClient, ServiceProblem
from tests.browser.browsing import browsing, chromium
from tests.system.rest_bench import Service, VirtualMachine, serving, until, virtual_machine


@pytest.fixture(scope="module", autouse=True)
def browser() -> Iterator[None]:
    """One for all windows of a module."""
    with chromium():
        yield


@pytest.fixture
def machine(tmp_path: Path) -> Iterator[VirtualMachine]:
    with virtual_machine(tmp_path, speed_factor=1.0) as machine:
        yield machine


@pytest.fixture
def service(tmp_path: Path, machine: VirtualMachine) -> Iterator[Service]:
    """Connected to the machine: at its start a busy computer may let the drives answer too late."""
    with serving(tmp_path, machine.profile) as service:
        with ServiceClient(service.url) as client:
            until(lambda: connected(client), "the machine is connected")
        yield service


def connected(client: ServiceClient) -> bool:
    if client.drives()["connected"]:
        return True
    with suppress(ServiceProblem):
        client.connect()
    return False


@pytest.fixture
def page(service: Service) -> Iterator[Page]:
    with browsing(service.url) as page:
        yield page
