"""A product while it is drawn: bodies at their places, and what holds them together."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from takeapart.generate.products.solids import Point, Solid, mesh_of, require_manifold
from takeapart.model.assembly import Assembly, Joint, JointKind, Part
from takeapart.model.geometry import Array
from takeapart.model.meshes import Mesh

ALUMINIUM, STEEL, BRASS, PLASTIC, CARBON, BRONZE, GLASS = (
    2700.0,
    7850.0,
    8500.0,
    1100.0,
    1600.0,
    8800.0,
    2500.0,
)  # kg/m^3
GENERATOR = "takeapart.products"


@dataclass(eq=False)
class Drawing:
    """Collects the parts of a product.

    Args:
        name: of the product.
        title: what it is, in a few words.
        place: m, where the drawing's origin stands in the workcell.
        turn: degrees about z, by which the drawing is turned there.
        workcell: the shipped one that it is made for.
    """

    name: str
    title: str
    place: Point
    turn: float = 0.0
    workcell: str = "panda"
    _parts: list[Part] = field(default_factory=list)
    _joints: list[Joint] = field(default_factory=list)
    _shapes: dict[str, Mesh] = field(default_factory=dict)

    def __post_init__(self) -> None:
        require_manifold()

    def add(
        self,
        name: str,
        solid: Solid,
        density: float,
        at: Point = (0.0, 0.0, 0.0),
        rotation: Array | None = None,
        fixed: bool = False,
    ) -> None:
        """A part where it stands in the drawing.

        Args:
            solid: in mm, in the part's frame.
            density: kg/m^3.
            at: mm, of the part's frame.
            rotation: (3, 3) of the part's frame; by default none.
        """
        mesh = mesh_of(solid)
        mesh = self._shapes.setdefault(mesh.hash, mesh)
        T = np.eye(4)
        T[:3, :3] = np.eye(3) if rotation is None else rotation
        T[:3, 3] = np.array(at) / 1000.0
        mass = round(density * mesh.volume(), 6)
        self._parts.append(Part(name, mesh, self._stand() @ T, mass, fixed))

    def join(
        self, name: str, kind: JointKind, first: str, second: str, points: list[Point], axis: Point, strength: float
    ) -> None:
        """What fastens the second part to the first, at points in mm; the second leaves along the axis. N at each."""
        T = self._stand()
        world = np.array(points) / 1000.0 @ T[:3, :3].T + T[:3, 3]
        direction = T[:3, :3] @ np.array(axis, dtype=float)
        self._joints.append(
            Joint(name, kind, first, second, world, direction / np.linalg.norm(direction), strength, strength)
        )

    def assembly(self) -> Assembly:
        """The product."""
        provenance: dict[str, object] = {"generator": GENERATOR, "title": self.title, "workcell": self.workcell}
        return Assembly(self.name, tuple(self._parts), provenance=provenance, joints=tuple(self._joints))

    def _stand(self) -> Array:
        T = np.eye(4)
        T[:3, :3] = about_z(self.turn)
        T[:3, 3] = self.place
        return T


def about_z(degrees: float) -> Array:
    """Rotation (3, 3) about z; exact for quarter turns."""
    turns = degrees / 90.0
    if turns == round(turns):
        c, s = ((1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0))[round(turns) % 4]
    else:
        c, s = float(np.cos(np.radians(degrees))), float(np.sin(np.radians(degrees)))
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def about_y(degrees: float) -> Array:
    """Rotation (3, 3) about y."""
    c, s = float(np.cos(np.radians(degrees))), float(np.sin(np.radians(degrees)))
    return np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]])
