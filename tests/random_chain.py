"""Random serial chains as URDF: 1 to 7 moving joints, revolute and prismatic, with fixed joints in between."""

from typing import Any

import numpy as np

from service.model import Axis, Robot, RobotDescription, build_robot


def random_arm(seed: int, joints: int, **axis: Any) -> Robot:
    """A robot of turning joints with gears of 100; `axis`: what all of them have in common."""
    axes = tuple(Axis(joint=f"joint_{k}", gear_ratio=100.0, **axis) for k in range(1, joints + 1))
    text = random_urdf(np.random.default_rng(seed), joints, prismatic=0.0)
    return build_robot(RobotDescription(name="r", urdf="r.urdf", axes=axes), text)


def random_urdf(rng: np.random.Generator, joints: int, prismatic: float = 0.25) -> str:
    """A chain whose links are physical (positive definite inertia about their centre of mass)."""
    parts = ['<robot name="random">', '<link name="base"/>']
    parent = "base"
    for number in range(1, joints + 1):
        if rng.random() < 0.3:
            parts.append(_link(rng, f"flange_{number}"))
            parts.append(_joint(rng, f"mount_{number}", "fixed", parent, f"flange_{number}"))
            parent = f"flange_{number}"
        kind = "prismatic" if rng.random() < prismatic else "revolute"
        parts.append(_link(rng, f"link_{number}"))
        parts.append(_joint(rng, f"joint_{number}", kind, parent, f"link_{number}"))
        parent = f"link_{number}"
    parts.append("</robot>")
    return "\n".join(parts)


def _link(rng: np.random.Generator, name: str) -> str:
    root = rng.normal(size=(3, 3))
    tensor = root @ root.T + np.eye(3)
    tensor = np.eye(3) * np.trace(tensor) - tensor  # satisfies the triangle inequality
    values = dict(zip(("ixx", "ixy", "ixz", "iyy", "iyz", "izz"), tensor[np.triu_indices(3)], strict=True))
    inertia = " ".join(f'{key}="{float(value)!r}"' for key, value in values.items())
    return (
        f'<link name="{name}"><inertial>{_origin(rng)}<mass value="{rng.uniform(1, 50)}"/>'
        f"<inertia {inertia}/></inertial></link>"
    )


def _joint(rng: np.random.Generator, name: str, kind: str, parent: str, child: str) -> str:
    axis = rng.normal(size=3)
    axis /= np.linalg.norm(axis)
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>{_origin(rng)}'
        f'<axis xyz="{_text(axis)}"/>'
        '<limit lower="-2.5" upper="2.5" velocity="2" effort="1000"/></joint>'
    )


def _origin(rng: np.random.Generator) -> str:
    return f'<origin xyz="{_text(rng.uniform(-0.6, 0.6, 3))}" rpy="{_text(rng.uniform(-3, 3, 3))}"/>'


def _text(values: np.ndarray) -> str:
    return " ".join(repr(float(value)) for value in values)
