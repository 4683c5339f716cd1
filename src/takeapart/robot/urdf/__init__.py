"""The one reader of URDF: links, joints and geometry of a robot's file, and where its links are.

`read_urdf` reads a file; the parsing itself is yourdfpy's. `Urdf` answers which links hang on which, and where they
are for given values of the joints. `meshes` has the geometry of links as triangles.
"""

from takeapart.robot.urdf.meshes import TriangleMesh, collisions, convex_corners, visuals
from takeapart.robot.urdf.reading import read_urdf
from takeapart.robot.urdf.tree import Geometry, Joint, Link, Mimic, Urdf

__all__ = [
    "Geometry",
    "Joint",
    "Link",
    "Mimic",
    "TriangleMesh",
    "Urdf",
    "collisions",
    "convex_corners",
    "read_urdf",
    "visuals",
]
