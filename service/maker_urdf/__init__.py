"""A robot as its maker describes it, a URDF with meshes, brought into the form that the service plans with.

`chain` chooses one serial chain and fixes what does not belong to it, `packages` finds mesh files and reads nothing
else, `meshes` and `collada` read their points, `hulls` writes convex hulls into the URDF, `inertials` completes links
without mass, `check` tells what is unusual and what is missing, `draft` writes the files to be completed.
"""

from service.maker_urdf.check import Told, check_urdf
from service.maker_urdf.draft import cell_text, side_file_text
from service.maker_urdf.finding import Finding

__all__ = ["Finding", "Told", "cell_text", "check_urdf", "side_file_text"]
