"""A stop by the API whose confirmation nobody waits for; all others are in tests/virtual_time/test_stop_truth.py."""

import asyncio
import json
from pathlib import Path

import httpx

from drivers.contract.bench import eventually
from service.machine.stop_process.handle import StopProcess
from service.process.settings import Settings
from service.web.app import create_app
from tests.contract.bench import BENCHES, EDS, ROOT

STOP = "http://127.0.0.1/api/v1/stop"


async def test_a_stop_that_is_not_waited_for_says_only_that_it_was_sent(tmp_path: Path) -> None:
    bench, path = BENCHES["canopen-socketcand"], tmp_path / "drive.yaml"
    with bench.machine(bench) as virtual:
        path.write_text(json.dumps({**virtual.profile, "eds": str(EDS)}), "utf-8")
        settings = Settings(
            data_dir=tmp_path / "data", drive=path, robots_dir=ROOT / "config/robots", cells_dir=ROOT / "config/cells"
        )
        with StopProcess(path, "127.0.0.1", 0) as process:
            app = create_app(settings, stop_process=process)
            async with app.router.lifespan_context(app):
                machine = app.state.application.machine
                await eventually(lambda: process.trouble == "" and machine.connected)
                async with httpx.AsyncClient(transport=httpx.ASGITransport(app=app), timeout=10) as http:
                    async with asyncio.timeout(20):
                        while (await http.post(STOP, params={"by": "Ada"})).status_code != 200:
                            pass  # a busy computer may confirm after the second that an answer has
                    answer = await http.post(STOP, params={"by": "Ada", "wait": "0"})
                await machine.close()
    assert answer.status_code == 202
    sent = answer.json()
    assert set(sent["sent"]) == {f"joint_{number}" for number in range(1, 7)}
    assert (sent["confirmed"], sent["unconfirmed"]) == ([], {})
