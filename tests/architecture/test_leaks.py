"""The check in tests/conftest.py bites: a leaking test fails, and says what it left running."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.slow

LEAKS = """
import asyncio
import threading

import conftest

conftest.PATIENCE = 0.2

end = threading.Event()

def hang():
    end.wait(60)

async def hang_too():
    await asyncio.sleep(60)

def test_thread():
    threading.Thread(target=hang, name="left-behind").start()

async def test_task():
    test_task.kept = asyncio.create_task(hang_too())

async def test_clean():
    thread = threading.Thread(target=hang)
    thread.start()
    end.set()
    await asyncio.create_task(asyncio.sleep(0))
"""


def test_leaks_are_found(root: Path, tmp_path: Path) -> None:
    (tmp_path / "tests").mkdir()
    (tmp_path / "drivers").mkdir()
    for name in ("conftest.py", "tiers.py"):
        shutil.copy(root / "tests" / name, tmp_path / "tests")
    (tmp_path / "drivers/test_leak.py").write_text(LEAKS)
    outside = {key: value for key, value in os.environ.items() if not key.startswith("PYTEST_")}
    ran = subprocess.run(
        [sys.executable, "-m", "pytest", "-p", "conftest", "-o", "asyncio_mode=auto", "drivers/test_leak.py"],
        cwd=tmp_path,
        env=outside | {"PYTHONPATH": f"{tmp_path}:{tmp_path / 'tests'}:{root}"},
        capture_output=True,
        text=True,
    )
    assert "threads left running: left-behind" in ran.stdout
    assert "tasks left running: <coroutine object hang_too" in ran.stdout
    assert "test_clean" not in ran.stdout
