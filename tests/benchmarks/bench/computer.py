"""On what it was measured."""

import os
import platform
from importlib.metadata import version
from pathlib import Path

import psutil

PACKAGES = ("numpy", "scipy", "mujoco-core", "pin", "python-can", "fastapi", "uvicorn", "pyarrow")


def computer() -> dict[str, str | int | float]:
    """What matters for speed; no names of the computer."""
    return {
        "processor": _processor(),
        "processors": os.cpu_count() or 0,
        "memory_GiB": round(psutil.virtual_memory().total / 2**30),
        "system": f"{platform.system()} {platform.release()}",
        "python": platform.python_version(),
        "packages": ", ".join(f"{name} {version(name)}" for name in PACKAGES),
        "threads": os.environ.get("OMP_NUM_THREADS", "as many as there are"),
    }


def _processor() -> str:
    info = Path("/proc/cpuinfo")
    lines = info.read_text("utf-8").splitlines() if info.exists() else []
    names = (line.partition(":")[2].strip() for line in lines if line.startswith("model name"))
    return next(names, platform.machine())
