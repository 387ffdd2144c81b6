"""Converts the URDF and meshes of a robot's manufacturer to the form that the service needs for planning.

`macros` expands xacro, `chain` selects one serial chain and fixes the other joints, `packages` finds mesh files,
`meshes` and `collada` read their points, `hulls` writes convex hulls into the URDF, `inertials` checks masses and
completes links without, `check` reports unusual and missing data, `draft` writes the files that the user completes,
`virtual` a virtual machine.
"""

from service.formats.maker_urdf.chain import Finding
from service.formats.maker_urdf.check import UrdfCheck, bare_robot, cell_text, check_urdf, side_file_text
from service.formats.maker_urdf.packages import read_description

__all__ = ["Finding", "UrdfCheck", "bare_robot", "cell_text", "check_urdf", "read_description", "side_file_text"]
