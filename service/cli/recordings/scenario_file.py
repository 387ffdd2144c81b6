"""The scenario of a diagnosed robot, for the virtual machine."""

from pathlib import Path

import yaml

from service.cli.documents import write_file
from service.model.results.diagnosis import DiagnosedModel
from service.model.robot import Robot


def write_scenario(path: Path, robot: Robot, model: DiagnosedModel) -> None:
    """The model's scenario, which the virtual machine can load: with the robot's description and URDF beside it."""
    description = robot.description.model_dump(mode="json") | {"urdf": f"{path.stem}-robot.urdf"}
    files = {
        description["urdf"]: robot.urdf_text,
        f"{path.stem}-robot.yaml": yaml.safe_dump(description, sort_keys=False),
        path.name: yaml.safe_dump({**model.scenario, "robot": f"{path.stem}-robot.yaml"}, sort_keys=False),
    }
    for name, text in files.items():
        write_file(path.parent / name, text)
