"""Converts the URDF and meshes of a robot's manufacturer to the form that the service needs for planning.

`packages` expands xacro, finds mesh files and reads their points, `chain` selects one serial chain and fixes the other
joints, `inertials` writes convex hulls into the URDF, checks masses and completes links without, `check` reports
unusual and missing data and writes the files that the user completes, `virtual` a virtual machine.
"""

from service.formats.maker_urdf.chain import UrdfFinding
from service.formats.maker_urdf.check import UrdfCheck, bare_robot, cell_text, check_urdf, side_file_text
from service.formats.maker_urdf.packages import read_description

__all__ = ["UrdfCheck", "UrdfFinding", "bare_robot", "cell_text", "check_urdf", "read_description", "side_file_text"]
