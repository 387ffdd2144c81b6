"""Converts the URDF and meshes of a robot's manufacturer to the form that the service needs for planning.

`chain` selects one serial chain and fixes the other joints, `packages` finds mesh files and reads no other files,
`meshes` and `collada` read their points, `hulls` writes convex hulls into the URDF, `inertials` completes links
without mass, `check` reports unusual and missing data, `draft` writes the files that the user completes.
"""

from service.maker_urdf.check import UrdfCheck, check_urdf
from service.maker_urdf.draft import cell_text, side_file_text
from service.maker_urdf.finding import Finding

__all__ = ["Finding", "UrdfCheck", "cell_text", "check_urdf", "side_file_text"]
