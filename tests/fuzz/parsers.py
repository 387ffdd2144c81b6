"""Everything of the product that reads files from outside, with what it starts from and which errors it may raise."""

import json
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import yaml

from drivers.canopen.profile import load_device_map, parse_profile as canopen_profile
from drivers.cia402.profile import refuse_unfilled
from drivers.commission.draft import map_text, profile_text
from drivers.commission.drive import read_dictionary
from drivers.errors import BadProfile
from drivers.modbus.profile import parse_profile as modbus_profile
from drivers.modbus.registers import load_registers
from drivers.registry import load_profile
from service import BadInput
from service.cli.commands.campaigns import plan_number
from service.cli.commands.export import export_path
from service.cli.commands.imports import import_control_file
from service.formats.export import identified_model
from service.formats.export.sheets.inertias import load_of
from service.formats.export.sheets.making import check_sheet, sheet
from service.formats.export.sheets.text import as_markdown
from service.formats.export.started_robot import started_from
from service.formats.maker_urdf.check import check_urdf, side_file_text
from service.formats.maker_urdf.packages import Packages
from service.formats.sinumerik.document import Given
from service.formats.traces.trace_import import import_trace, mapping_of, read_traces
from service.machine.execution.sweep_samples import read_stream
from service.machine.paths.sweep_paths import read_control
from service.model import Robot, read_chain
from service.model.collision import CollisionChecker
from service.model.configuration import read_cell, read_robot, read_text
from service.model.results.estimate import Estimate
from service.model.results.payload import Payload
from service.process.settings import load_settings
from service.store.back_up import read_manifest
from service.store.files.bundle import read_from, write_bundle
from service.store.files.columns import UnreadableStream, read_columns
from simulator.drive.dictionary import ObjectDictionary
from simulator.modbus.registers import RegisterMapError, load_register_map
from simulator.scenario import ScenarioError, load_scenario
from sweepid.files import read_document, read_effects, read_gains
from tests.fuzz import measurement_files, seeds
from tests.fuzz.seeds import CONFIG, Seed
from tests.stored.documents import payload

ROBOT = "robots/max100-class.yaml"
URDF = "robots/max100-class.urdf"


@dataclass(frozen=True)
class Parser:
    """`read` is given the entry of a seed, and a folder beside it in which it may write."""

    seeds: Callable[[], Iterable[Seed]]
    read: Callable[[Path, Path], object]
    allowed: tuple[type[Exception], ...] = (BadInput,)


@cache
def _robot() -> Robot:
    return read_robot(CONFIG / ROBOT)


def _named(pattern: str, *others: str) -> Callable[[], Iterable[Seed]]:
    """Every file of `config` like this, each with others that stay as they are."""
    names = sorted(path.relative_to(CONFIG).as_posix() for path in CONFIG.glob(pattern))
    return lambda: [seeds.of_config(name, *others, targets=(name,)) for name in names]


def _shapes(path: Path, work: Path) -> None:
    CollisionChecker(read_robot(path), read_cell(CONFIG / "cells/workshop.yaml"))


def _maker(path: Path, work: Path) -> None:
    told = check_urdf(read_text(path), Packages([path.parent], path.parent), "tip", str(path))
    side_file_text(told, "x", "x.urdf")


def _estimate(path: Path, work: Path) -> None:
    estimate = read_document(path, Estimate)
    identified_model(_robot(), estimate.as_json(), str(path))
    made = sheet(_robot(), estimate, str(path))
    as_markdown(made)
    check_sheet(made, str(path))


def _payload(path: Path, work: Path) -> None:
    load = load_of(read_document(path, Payload, "--payload"))
    estimate = Estimate.read(json.loads(seeds.estimate()), "estimate")
    as_markdown(sheet(_robot(), estimate, "estimate"), load)


def _trace(path: Path, work: Path) -> None:
    robot, sweeps = import_trace(path)
    write_bundle(work / "bundle", robot, sweeps)


def _trace_alone(path: Path, work: Path) -> None:
    known = mapping_of(path, rated_effort=50.0, torque_constant=1.0, gear_ratio=5.0, inertia=4.0)
    read_traces(known, path)


def _paths(path: Path, work: Path) -> None:
    plan_number(str(path))
    cell, control = CONFIG / "cells/workshop.yaml", CONFIG / "controls/sinumerik.yaml"
    export_path(path, CONFIG / ROBOT, cell, control, work / "paths")


def _profile(path: Path, work: Path) -> None:
    content = load_profile(path)
    parse = modbus_profile if content.get("adapter") == "modbus" else canopen_profile
    profile = parse(content, path.parent)
    registers = getattr(profile, "registers", None)
    if registers is not None:
        load_registers(registers)


def _profiles() -> Iterable[Seed]:
    eds, devices = "eds/virtual-axis.eds", "devices/virtual-axis.yaml"
    yield seeds.of_config("drives/virtual-max100.yaml", eds, targets=("drives/virtual-max100.yaml",) * 2 + (eds,))
    mapped = seeds.of_config("drives/virtual-max100.yaml", eds, devices, targets=(devices,))
    drive = mapped.files[mapped.entry] + b"device: ../devices/virtual-axis.yaml\n"
    yield Seed(mapped.files | {mapped.entry: drive}, mapped.entry, mapped.targets)
    for end in ("tcp", "rtu"):
        yield seeds.of_config(f"drives/virtual-max100-modbus-{end}.yaml", "registers/virtual-high-first.yaml",
                              "registers/virtual-low-first.yaml")  # fmt: skip


def _dictionaries() -> Iterable[Seed]:
    yield from _named("eds/*.eds")()
    yield from seeds.shared("drives/*.dcf")


def _drafts(path: Path) -> None:
    dictionary = read_dictionary(path, 3)
    for text in (profile_text(dictionary, ["a"], path.name, "b.yaml", None), map_text(dictionary)):
        try:
            refuse_unfilled(yaml.safe_load(text))
        except BadProfile:
            continue
        raise AssertionError("a draft without an open value")


def _robots() -> Iterable[Seed]:
    for name in ("max100-class", "emps"):
        yield seeds.of_config(f"robots/{name}.yaml", f"robots/{name}.urdf")


def _scenarios() -> Iterable[Seed]:
    for seed in _named("scenarios/*.yaml", ROBOT, URDF)():
        yield Seed(seed.files, seed.entry, (seed.entry, seed.entry, ROBOT, URDF))


def _settings() -> Iterable[Seed]:
    yield seeds.of_config("service.yaml")
    yield seeds.one("all.yaml", "data_dir: var\nhost: 0.0.0.0\nallowed_hosts: [cell]\nport: 1\nlease_time: 2.0\n")


PARSERS: Mapping[str, Parser] = {
    "bundle": Parser(lambda: [seeds.bundle()], lambda path, work: read_from(path, work / "bundle")),
    "bundle zip": Parser(lambda: [seeds.packed(seeds.bundle())], lambda path, work: read_from(path, work / "bundle")),
    "parquet": Parser(
        lambda: [seeds.one("a.parquet", seeds.bundle().files["sweeps/0001.parquet"])], lambda p, _: read_columns(p)
    ),
    "csv": Parser(lambda: [seeds.one("a.csv", seeds.as_csv(seeds.columns()))], lambda path, _: read_columns(path)),
    "recorder's stream": Parser(
        lambda: [seeds.one("a.arrow", seeds.as_stream(seeds.columns()))],
        lambda path, _: read_stream(path),
        (BadInput, UnreadableStream),
    ),
    "urdf": Parser(_named("robots/*.urdf"), lambda path, _: read_chain(read_text(path), str(path))),
    "shapes": Parser(lambda: [seeds.of_config(ROBOT, URDF, targets=(URDF,))], _shapes),
    "maker's urdf": Parser(lambda: [seeds.maker()], _maker),
    "robot": Parser(_robots, lambda path, _: read_robot(path)),
    "cell": Parser(_named("cells/*.yaml"), lambda path, _: read_cell(path).home_pose(_robot().joints)),
    "control": Parser(_named("controls/*.yaml"), lambda path, _: read_control(path, _robot())),
    "settings": Parser(_settings, lambda path, _: load_settings(path)),
    "gains": Parser(
        lambda: [seeds.one("g.yaml", "axes: {joint_1: {gain: {value: 1.1, std: 0.1}, poses: 3}}")],
        lambda path, _: read_gains(path),
    ),
    "drive profile": Parser(_profiles, _profile, (BadProfile,)),
    "device map": Parser(_named("devices/*.yaml"), lambda path, _: load_device_map(path), (BadProfile,)),
    "drive's dictionary": Parser(_dictionaries, lambda path, _: _drafts(path), (BadProfile,)),
    "simulator's registers": Parser(
        _named("registers/*.yaml"), lambda path, _: load_register_map(path), (RegisterMapError,)
    ),
    "simulator's eds": Parser(_named("eds/*.eds"), lambda path, _: ObjectDictionary(path, 3), (ScenarioError,)),
    "foreign eds": Parser(_dictionaries, lambda path, _: ObjectDictionary(path, 3, None), (ScenarioError,)),
    "scenario": Parser(_scenarios, lambda path, _: load_scenario(path), (ScenarioError,)),
    "trace": Parser(lambda: list(seeds.traces()), _trace),
    "trace alone": Parser(lambda: list(seeds.traces_alone()), _trace_alone),
    "backup": Parser(
        lambda: [seeds.one("manifest.json", seeds.manifest())], lambda path, _: read_manifest(path.parent)
    ),
    "mat": Parser(measurement_files.mat, lambda path, _: measurement_files.read(path)),
    "mdf4": Parser(measurement_files.mdf4, lambda path, _: measurement_files.read(path)),
    "hdf5": Parser(measurement_files.hdf5, lambda path, _: measurement_files.read(path)),
    "sinumerik": Parser(
        lambda: list(seeds.controls()), lambda path, work: import_control_file(path, Given(0.8), work / "out", "-")
    ),
    "estimate": Parser(lambda: [seeds.one("estimate.json", seeds.estimate())], _estimate),
    "start of a diagnosis": Parser(
        lambda: [seeds.one("estimate.json", seeds.estimate())],
        lambda path, _: started_from(_robot(), read_document(path, Estimate).as_json(), "x", str(path)),
    ),
    "payload": Parser(lambda: [seeds.one("payload.json", json.dumps(payload()))], _payload),
    "model": Parser(lambda: [seeds.stored("model")], lambda path, _: read_effects(path, _robot())),
    "plan": Parser(lambda: [seeds.one("plan.json", seeds.plan())], _paths),
}
