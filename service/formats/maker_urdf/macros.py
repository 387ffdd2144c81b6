"""Xacro: macros that ROS expands to a URDF, expanded here by ROS' own program."""

import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from types import ModuleType
from typing import cast
from unittest.mock import patch
from xml.dom.minidom import Document

import xacro

from service.formats.maker_urdf.packages import Packages
from service.model.configuration import read_text
from service.model.errors import BadInput


def read_description(path: Path, packages: Packages, arguments: Mapping[str, str]) -> str:
    """The URDF in a file. A xacro file is expanded: ``$(find NAME)`` is the folder of that package.

    BadInput names the file that cannot be read or expanded, the argument without value, or the unknown package.
    """
    text = read_text(path)
    if path.suffix != ".xacro" and "<xacro:" not in text:
        return text

    def share(name: str) -> str:
        return str(packages.folder(name, str(path)))

    finder = ModuleType("ament_index_python.packages")
    vars(finder)["get_package_share_directory"] = share
    try:
        with patch.dict(sys.modules, {"ament_index_python": finder, finder.__name__: finder}):
            expand = cast(Callable[..., Document], vars(xacro)["process_file"])
            return expand(str(path), mappings=dict(arguments)).toxml()
    except Exception as error:  # noqa: BLE001 - the expressions in the file may raise any
        raise _refusal(error, path) from None


def _refusal(error: BaseException, path: Path) -> BadInput:
    cause = error
    while (inner := getattr(cause, "exc", None)) is not None:
        cause = inner
    if isinstance(cause, BadInput):
        return cause
    files: list[str] = getattr(xacro, "filestack", None) or [str(path)]
    if type(cause).__name__ == "ArgException":
        return BadInput(files[-1], f"argument {cause} has no value: give it by --xacro-arg {cause}:=VALUE")
    return BadInput(files[-1], f"xacro: {' '.join(str(error).split()) or repr(error)}")
