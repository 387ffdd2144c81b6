"""What is said of a stop within 1.2 s is the truth of the virtual machine, whatever lies between it and the drives."""

import asyncio
import json
import socket
import threading
import time
from collections.abc import AsyncIterator, Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import httpx
import pytest
import yaml

from drivers.errors import DriveError
from service.app import create_app
from service.settings import Settings
from service.stop_process.handle import StopProcess
from simulator.machine import Machine as VirtualPlant
from simulator.scenario import load_scenario
from simulator.virtual_drive import VirtualDrive
from tests.contract.bench import DRIVES, EDS, ROOT, SCENARIO
from tests.gateway import Gateway, Loss, gateway

ANSWERED = 1.2  # s
SPEED = 0.1  # rad/s
JOINTS = {f"joint_{number}" for number in range(1, 7)}


@dataclass
class Rig:
    """A service in this process, its stop process, a gateway, and a machine of which joint_1 moves."""

    virtual: VirtualDrive
    between: Gateway
    app: Any
    process: StopProcess
    moving: "asyncio.Task[None] | None" = None

    @property
    def machine(self) -> Any:
        return self.app.state.application.machine

    def truly_stand(self) -> bool:
        return all(not axis["energised"] and abs(axis["velocity"]) < 1e-3 for axis in self.truth().values())

    def truth(self) -> dict[str, dict[str, Any]]:
        with socket.create_connection(("127.0.0.1", self.virtual.control_port), timeout=10) as client:
            client.sendall(b'{"order": "status"}\n')
            return json.loads(client.makefile().readline())["axes"]

    async def move(self) -> None:
        """joint_1 is under way."""
        port = self.machine._port  # its motion is not what is tested
        await port.enable("joint_1")
        self.moving = asyncio.create_task(port.move_to("joint_1", 2.5, SPEED))
        await until(lambda: self.truth()["joint_1"]["velocity"] > 0.9 * SPEED)

    async def end(self) -> None:
        """Everything passes again, and what was going on comes to its end."""
        if self.between.loss is not Loss.GATEWAY:
            self.between.loss = Loss.NOTHING
        if self.moving is not None:
            with suppress(DriveError):
                await self.moving
        await self.machine.close()

    async def stop(self, way: str, **words: str) -> tuple[int, dict[str, Any], float, bool]:
        """Status, body, s until the answer, and whether the machine stands at that time."""
        transport = None if way == "port" else httpx.ASGITransport(app=self.app)
        address = f"http://127.0.0.1:{self.process.port}/stop" if way == "port" else "http://127.0.0.1/api/v1/stop"
        async with httpx.AsyncClient(transport=transport, timeout=10, trust_env=False, verify=False) as http:
            begun = time.monotonic()  # without the time that a client takes to read its certificates
            answer = await http.post(address, params=words)
            took = time.monotonic() - begun
        return answer.status_code, answer.json(), took, await asyncio.to_thread(self.truly_stand)


async def until(condition: Callable[[], bool]) -> None:
    async with asyncio.timeout(30):
        while not await asyncio.to_thread(condition):  # noqa: ASYNC110
            await asyncio.sleep(0.02)


@pytest.fixture
def virtual() -> Iterator[VirtualDrive]:
    virtual = VirtualDrive(VirtualPlant(load_scenario(SCENARIO), 0), EDS)
    thread = threading.Thread(target=virtual.run, name="virtual-drive")
    thread.start()
    try:
        yield virtual
    finally:
        virtual.stop()
        thread.join()
        virtual.close()


@pytest.fixture
async def rig(virtual: VirtualDrive, tmp_path: Path) -> AsyncIterator[Rig]:
    assert virtual.port is not None
    with gateway(virtual.port) as between:
        profile = yaml.safe_load((DRIVES / "virtual-max100.yaml").read_text("utf-8"))
        profile["eds"] = str(EDS)
        profile["bus"] |= {"host": "127.0.0.1", "port": between.port}
        path = tmp_path / "drive.yaml"
        path.write_text(json.dumps(profile), "utf-8")
        settings = Settings(
            data_dir=tmp_path / "data",
            drive=path,
            robots_dir=ROOT / "config/robots",
            cells_dir=ROOT / "config/cells",
            lease_time=60.0,
        )
        with StopProcess(path, "127.0.0.1", 0) as process:
            app = create_app(settings, stop_process=process)
            async with app.router.lifespan_context(app):
                rig = Rig(virtual, between, app, process)
                await until(lambda: process.trouble == "" and rig.machine.connected)
                yield rig


@pytest.mark.parametrize("way", ["port", "api"])
@pytest.mark.parametrize("loss", Loss, ids=lambda loss: loss.value)
async def test_what_is_said_of_a_stop_is_the_truth(rig: Rig, loss: Loss, way: str) -> None:
    await rig.move()
    rig.between.loss = loss
    status, body, took, stands = await rig.stop(way, by="Ada")
    assert took < ANSWERED
    if loss is Loss.NOTHING:
        assert (status, set(body["confirmed"]), body["unconfirmed"]) == (200, JOINTS, {})
        assert stands
    else:
        assert status == 503
        assert "joint_1" not in body["confirmed"]
        assert "joint_1" in body["unconfirmed"]
        assert body["detail"].startswith("stop ")
        assert body["detail"].endswith("; use the emergency stop")
    assert [stop.by for stop in rig.machine.stops] == ["Ada"]
    await rig.end()


async def test_a_busy_service_is_no_obstacle_to_a_confirmed_stop_by_the_port(rig: Rig) -> None:
    await rig.move()
    answers: list[httpx.Response] = []
    begun = time.monotonic()

    def press() -> None:
        address = f"http://127.0.0.1:{rig.process.port}/stop"
        answers.append(httpx.post(address, params={"by": "Ada"}, timeout=10, trust_env=False))

    pressing = threading.Thread(target=press)
    pressing.start()
    pressing.join()  # the event loop does nothing meanwhile
    assert time.monotonic() - begun < ANSWERED
    (answer,) = answers
    assert (answer.status_code, answer.json().get("unconfirmed")) == (200, {})
    assert rig.truly_stand()
    await rig.end()


async def test_a_suspended_service_is_no_obstacle_either(rig: Rig) -> None:
    """Nobody takes the stop over: the drives are made deaf, and yet heard."""
    await rig.move()
    rig.process.attach(None)
    status, body, took, stands = await rig.stop("port", by="Ada")
    assert (status, body.get("unconfirmed"), stands) == (200, {}, True)
    assert took < ANSWERED
    await rig.end()


async def test_a_stop_that_is_not_waited_for_says_only_that_it_was_sent(rig: Rig) -> None:
    await rig.stop("port", by="Ada")  # every drive has been heard by now
    for way in ("port", "api"):
        status, body, _, _ = await rig.stop(way, by="Ada", wait="0")
        assert (status, set(body["sent"]), list(body["confirmed"]), body["unconfirmed"]) == (202, JOINTS, [], {})
    await rig.end()
