"""Files of drives, virtual ones too, that are no files, no YAML, no mapping, or without end."""

from pathlib import Path
from typing import Any

import pytest

from drivers.canopen.device_map import load_device_map
from drivers.errors import BadProfile
from drivers.modbus.registers import load_registers
from drivers.registry import load_profile
from simulator.modbus.register_map import RegisterMapError, load_register_map
from simulator.scenario import ScenarioError, load_scenario

READERS: dict[str, Any] = {
    **{"profile": load_profile, "device map": load_device_map, "registers": load_registers},
    **{"virtual registers": load_register_map, "scenario": load_scenario},
}
ERRORS = (BadProfile, RegisterMapError, ScenarioError)
REFUSED = {
    b"\xff\xfe": "not YAML|cannot be read: .*utf-8",
    b"a: [": "not YAML",
    b"a: 2001-13-45": "not YAML",
    b"a: !!int ''": "not YAML",
    b"a: !!timestamp x": "not YAML",
    b"a: " + b"[" * 3000: "not YAML: nested too deeply, limit 32 levels",
    b"axes: " + b"[" * 33 + b"]" * 33: "not YAML: nested too deeply, limit 32 levels",
    b"&a {axes: *a}": r"not YAML: alias \*a is inside of its own anchor",
    b"axes: &a [{identity: *a}]": r"not YAML: alias \*a is inside of its own anchor",
    b"a: &a %s\nb: [%s]" % (b"n" * 100_000, b", ".join([b"*a"] * 100)): "aliases stand for more than 4194304 ",
    b" " * 2**20 + b"a": "is larger than|YAML of 1048577 characters, limit 1048576",
    b"- 1": "must be a mapping|map: Input|not a mapping",
}


@pytest.mark.parametrize("read", READERS.values(), ids=READERS)
@pytest.mark.parametrize(("content", "message"), REFUSED.items(), ids=[repr(each[:12]) for each in REFUSED])
def test_what_is_no_description_is_refused_by_name(read: Any, content: bytes, message: str, tmp_path: Path) -> None:
    """A profile that holds itself took all of Python's stack when its open values were looked for."""
    path = tmp_path / "it.yaml"
    path.write_bytes(content)
    with pytest.raises(ERRORS, match=rf"it\.yaml: .*({message})"):
        read(path)


@pytest.mark.parametrize("read", READERS.values(), ids=READERS)
def test_a_file_that_is_not_there_is_named(read: Any, tmp_path: Path) -> None:
    with pytest.raises(ERRORS, match=r"none\.yaml: .*No such file"):
        read(tmp_path / "none.yaml")
