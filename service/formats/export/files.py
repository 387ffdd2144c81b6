"""The files of an identified robot: URDF, MJCF, YAML, and the side file that sweepid needs to read it again."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path

import yaml

from service.formats.export.mjcf import as_mjcf
from service.formats.export.model import Body, IdentifiedModel
from service.formats.export.urdf import as_urdf
from service.model.errors import BadInput, writing
from service.model.robot import INERTIAL_NAMES

Yaml = str | float | None | Sequence["Yaml"] | Mapping[str, "Yaml"]

URDF = "model.urdf"


def model_files(model: IdentifiedModel) -> dict[str, str]:
    """Name and text of each file."""
    return {
        URDF: as_urdf(model),
        "model.xml": as_mjcf(model),
        "model.yaml": as_yaml(model),
        "robot.yaml": as_side_file(model),
    }


def write_model(folder: Path, model: IdentifiedModel) -> None:
    """Write the files into a folder that is empty or new; BadInput if it is not empty or cannot be written."""
    files = model_files(model)
    with writing(folder):
        if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
            raise BadInput(str(folder), "exists already and is not an empty folder")
        folder.mkdir(parents=True, exist_ok=True)
        for name, text in files.items():
            (folder / name).write_text(text, encoding="utf-8")


def as_yaml(model: IdentifiedModel) -> str:
    """All parameters, SI, for programs that read neither URDF nor MJCF. Inertias of motors are on the joint side."""
    joints = {
        joint.name: {
            "kind": joint.kind,
            "link": joint.link,
            "parent_to_joint": {"translation": joint.translation.tolist(), "rotation": joint.rotation.tolist()},
            "axis": joint.axis.tolist(),
            "motor_inertia": float(motor),
            "viscous_friction": friction,
            "dry_friction": dry,
            "effects": {
                effect.effect: {name: value.model_dump() for name, value in effect.parameters.items()}
                for effect in model.effects
                if effect.axis == joint.name
            },
        }
        for joint, motor, friction, dry in zip(
            model.robot.chain.joints, model.motor_inertias, model.friction, model.dry_friction, strict=True
        )
    }
    return _dump(
        {
            "robot": model.robot.name,
            "gravity": model.robot.gravity.tolist(),
            "joints": joints,
            "links": {body.link: _link(body) for body in model.bodies},
            "base_parameters": [
                {"name": one.name, "symbolic": one.symbolic, "value": one.value, "std": one.std}
                for one in model.base_parameters
            ],
            "symbols": {
                name: {"value": one.value, "unit": one.unit, "meaning": one.meaning}
                for name, one in model.symbols.items()
            },
            "deviation_in_std": model.deviation_in_std,
            "workspace": {
                one.joint: {"inertia": asdict(one.inertia), "gravity": asdict(one.gravity)} for one in model.worth
            },
        }
    )


def as_side_file(model: IdentifiedModel) -> str:
    """The side file of the robot with the identified motors and frictions, next to `model.urdf`."""
    axes = [
        axis.model_copy(
            update={
                "motor_inertia": float(motor) / axis.gear_ratio**2 if motor > 0 else axis.motor_inertia,
                "viscous_friction": axis.viscous_friction if friction is None else friction,
            }
        )
        for axis, motor, friction in zip(model.robot.axes, model.motor_inertias, model.friction, strict=True)
    ]
    description = model.robot.description.model_copy(update={"urdf": URDF, "axes": tuple(axes)})
    return _dump(description.model_dump(mode="json"))


def _link(body: Body) -> Yaml:
    return {
        "mass": body.mass,
        "centre_of_mass": body.centre.tolist(),
        "inertia_about_centre": body.inertia.tolist(),
        "at_frame": dict(zip(INERTIAL_NAMES, body.parameters.tolist(), strict=True)),
    }


def _dump(content: Yaml) -> str:
    return yaml.safe_dump(content, sort_keys=False, allow_unicode=True)
