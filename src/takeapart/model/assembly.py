"""The product: parts, the connectors that hold them, and the checks that make an assembly trustworthy.

Parts are numbered in the order of `Assembly.parts`. A *state* is an `int` whose bit i says that part i is still there;
fixed parts never leave and stand in no state. `Assembly.root` is the state in which every removable part is present.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Literal

import numpy as np

from takeapart.model.errors import InputError, UnknownNameError
from takeapart.model.geometry import Array, Box, OrientedBox, Shape, box_separation
from takeapart.states import members

SHORTEST_EDGE, LONGEST_EDGE = 1e-4, 100.0  # m, of a box
OVERLAP_TOLERANCE = 1e-4  # m; bodies of different parts may overlap by this much (rounding of drawings)
MAXIMUM_PARTS = 1000
NAME_PATTERN = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,63}")

ConnectorKind = Literal["U", "O"]
JointKind = Literal["clutch", "snap", "screw", "glue"]

CONTACT_GAP = 5e-4  # m; surfaces as close as this count as touching, unless the product says otherwise
FRICTION = 0.1  # between parts, unless the product says otherwise


@dataclass(frozen=True, eq=False)
class Part:
    """A rigid body of the assembly.

    Args:
        name: unique in the assembly.
        shape: geometry in the part's frame.
        T_world_part: (4, 4) pose in the finished assembly; the world frame is the assembly's frame.
        mass: kg, positive.
        fixed: a fixed part never leaves and must never be hit.
    """

    name: str
    shape: Shape
    T_world_part: Array
    mass: float
    fixed: bool = False

    def boxes_in_world(self) -> list[OrientedBox]:
        """The boxes of the shape where the part stands in the finished assembly."""
        return [box.moved(self.T_world_part) for box in self.shape.boxes()]


@dataclass(frozen=True, eq=False)
class Connector:
    """A holder that stays on its host part and carries the end of a guest part (Sec. IV).

    Args:
        kind: "U" is open upwards (floor and two cheeks), "O" encloses the guest's end with four walls.
        host: name of the part that the connector is fastened to; it leaves together with this part.
        guest: name of the part whose end it carries.
        walls: boxes in the host's part frame.
    """

    name: str
    kind: ConnectorKind
    host: str
    guest: str
    walls: tuple[OrientedBox, ...]


@dataclass(frozen=True, eq=False)
class Joint:
    """What fastens two parts to each other: at each of its points it pulls them together, up to a strength.

    Args:
        kind: "clutch" (studs of bricks), "snap", "screw" or "glue".
        first, second: names of the parts.
        points: (K, 3) m, where it acts; world frame, in the finished assembly.
        axis: (3,) unit vector along which the second part leaves the first; world frame.
        strength: N at each point: more tension than this, and it comes apart.
        release: N, in all, to take it apart.
        pitch: m of travel along the axis in one turn, positive for a right-hand thread; 0 where nothing turns.
    """

    name: str
    kind: JointKind
    first: str
    second: str
    points: Array
    axis: Array
    strength: float
    release: float = 0.0
    pitch: float = 0.0


@dataclass(frozen=True, eq=False)
class Assembly:
    """Parts, connectors and joints; validated on construction.

    Args:
        name: used in messages and file names.
        parts: at least one removable part.
        connectors: host and guest name existing, different parts.
        witness: names of the removable parts in an order that is known to be feasible, or empty.
        provenance: how the assembly was made (generator options, seed); free of meaning for planning.
        joints: what fastens parts to each other.
        friction: coefficient between parts.
        contact_gap: m; surfaces as close as this count as touching.
        allowed_overlaps: pairs of names of parts that overlap as drawn, and are meant to.

    Raises:
        InputError: duplicate or bad names, non-finite or non-positive numbers, improper rotations, unknown host or
            guest, boxes of different parts that overlap by more than 0.1 mm, a witness that is not an order of the
            removable parts. How meshes overlap is not looked at here.
    """

    name: str
    parts: tuple[Part, ...]
    connectors: tuple[Connector, ...] = ()
    witness: tuple[str, ...] = ()
    provenance: dict[str, object] = field(default_factory=dict)
    joints: tuple[Joint, ...] = ()
    friction: float = FRICTION
    contact_gap: float = CONTACT_GAP
    allowed_overlaps: tuple[tuple[str, str], ...] = ()

    def __post_init__(self) -> None:
        _check_names(self)
        _check_numbers(self)
        _check_connectors(self)
        _check_contacts(self)
        _check_witness(self)
        _check_overlap(self)

    @cached_property
    def index(self) -> dict[str, int]:
        """Number of the part of a given name."""
        return {part.name: i for i, part in enumerate(self.parts)}

    @cached_property
    def has_meshes(self) -> bool:
        """Whether any part is more than a box."""
        return any(not isinstance(part.shape, Box) for part in self.parts)

    @cached_property
    def is_lifted(self) -> bool:
        """Whether its parts leave straight upwards by the workcell's lift height and no other way: those of a product
        of boxes do (Sec. IV-B)."""
        return not self.has_meshes

    @cached_property
    def stands_in_connectors(self) -> bool:
        """Whether connectors say what carries what; a product without any, or with meshes, stands on level
        ground at its lowest point."""
        return bool(self.connectors) and not self.has_meshes

    @cached_property
    def root(self) -> int:
        """State in which all removable parts are present."""
        return sum(1 << i for i, part in enumerate(self.parts) if not part.fixed)

    def body(self, i: int) -> tuple[OrientedBox, ...]:
        """All boxes that move with part i, in its part frame: its shape, then the connectors that it hosts."""
        return (*self.parts[i].shape.boxes(), *self.walls(i))

    def walls(self, i: int) -> tuple[OrientedBox, ...]:
        """Walls of the connectors that part i hosts, in its part frame."""
        name = self.parts[i].name
        return tuple(wall for connector in self.connectors if connector.host == name for wall in connector.walls)

    def names(self, state: int) -> list[str]:
        """Names of the parts in a state, in part order."""
        return [self.parts[i].name for i in members(state)]

    def state_of(self, names: list[str] | tuple[str, ...]) -> int:
        """State that holds exactly the named parts."""
        state = 0
        for name in names:
            if name not in self.index:
                raise UnknownNameError("part", name, list(self.index), self.name)
            state |= 1 << self.index[name]
        return state


def _check_names(assembly: Assembly) -> None:
    if not assembly.parts:
        raise InputError("the assembly has no parts; at least one is needed", f"{assembly.name}: parts")
    if len(assembly.parts) > MAXIMUM_PARTS:
        raise InputError(f"{len(assembly.parts)} parts; at most {MAXIMUM_PARTS} are allowed", f"{assembly.name}: parts")
    groups: list[tuple[str, Sequence[Part | Connector | Joint]]] = [
        ("parts", assembly.parts),
        ("connectors", assembly.connectors),
        ("joints", assembly.joints),
    ]
    for kind, items in groups:
        seen: dict[str, int] = {}
        for i, item in enumerate(items):
            where = f"{assembly.name}: {kind}[{i}].name"
            if not NAME_PATTERN.fullmatch(item.name):
                raise InputError(f"bad name {item.name!r}; use 1 to 64 letters, digits, '.', '_' or '-'", where)
            if item.name in seen:
                raise InputError(f"name {item.name!r} is used before, by {kind}[{seen[item.name]}]", where)
            seen[item.name] = i
    if not assembly.root:
        raise InputError("every part is fixed; at least one must be removable", f"{assembly.name}: parts")


def _check_pose(T: Array, where: str) -> None:
    if T.shape != (4, 4) or not np.isfinite(T).all():
        raise InputError("the pose must be a finite (4, 4) matrix", where)
    R = T[:3, :3]
    if np.abs(R @ R.T - np.eye(3)).max() > 1e-6 or np.linalg.det(R) < 0:
        raise InputError("the rotation is not proper; use a unit quaternion (w, x, y, z)", where)
    if np.abs(T[:3, 3]).max() > 100:
        raise InputError(f"position {T[:3, 3].tolist()} m is beyond 100 m; are the units metres?", where)


def _check_box(box: OrientedBox, where: str) -> None:
    edges = 2 * box.half_extents
    if not np.isfinite(edges).all() or (edges < SHORTEST_EDGE * (1 - 1e-9)).any() or edges.max() > LONGEST_EDGE:
        sizes = f"{SHORTEST_EDGE:g} to {LONGEST_EDGE:g} m"
        raise InputError(f"size {edges.tolist()} m; {sizes} is valid for every edge; are the units metres?", where)
    _check_pose(box.T_frame_box, where)


def _check_numbers(assembly: Assembly) -> None:
    for i, part in enumerate(assembly.parts):
        where = f"{assembly.name}: parts[{i}] ({part.name})"
        _check_pose(part.T_world_part, f"{where}.pose")
        if not np.isfinite(part.mass) or part.mass <= 0:
            raise InputError(f"mass {part.mass} kg; it must be a positive number", f"{where}.mass")
        if isinstance(part.shape, Box):
            _check_box(part.shape.bounding_box(), f"{where}.shape")
    for i, connector in enumerate(assembly.connectors):
        for k, wall in enumerate(connector.walls):
            _check_box(wall, f"{assembly.name}: connectors[{i}] ({connector.name}).walls[{k}]")


def _check_connectors(assembly: Assembly) -> None:
    for i, connector in enumerate(assembly.connectors):
        where = f"{assembly.name}: connectors[{i}] ({connector.name})"
        if connector.kind not in ("U", "O"):
            raise UnknownNameError("connector kind", connector.kind, ["U", "O"], f"{where}.kind")
        for role in ("host", "guest"):
            if getattr(connector, role) not in assembly.index:
                raise InputError(f"there is no part {getattr(connector, role)!r}", f"{where}.{role}")
        if connector.host == connector.guest:
            raise InputError(f"host and guest are the same part {connector.host!r}", where)
        if not connector.walls:
            raise InputError("a connector needs at least one wall", f"{where}.walls")


def _check_contacts(assembly: Assembly) -> None:
    if not 0 <= assembly.friction <= 10:
        raise InputError(f"{assembly.friction}; must be from 0 to 10", f"{assembly.name}: friction")
    if not 0 <= assembly.contact_gap <= 0.01:
        raise InputError(f"{assembly.contact_gap} m; must be from 0 to 0.01", f"{assembly.name}: contact_gap")
    pairs = [(f"allowed_overlaps[{i}]", pair) for i, pair in enumerate(assembly.allowed_overlaps)]
    pairs += [(f"joints[{i}] ({joint.name})", (joint.first, joint.second)) for i, joint in enumerate(assembly.joints)]
    for place, pair in pairs:
        for name in pair:
            if name not in assembly.index:
                raise InputError(f"there is no part {name!r}", f"{assembly.name}: {place}")
        if pair[0] == pair[1]:
            raise InputError(f"{pair[0]!r} is named twice; two different parts are needed", f"{assembly.name}: {place}")
    for i, joint in enumerate(assembly.joints):
        where = f"{assembly.name}: joints[{i}] ({joint.name})"
        numbers = np.array([joint.strength, joint.release])
        if joint.points.ndim != 2 or joint.points.shape[1] != 3 or not len(joint.points):
            raise InputError("needs at least one point, each of three coordinates, m", f"{where}.points")
        if not np.isfinite(joint.points).all() or np.abs(joint.points).max() > 100:
            raise InputError("must be finite coordinates within 100 m", f"{where}.points")
        if joint.axis.shape != (3,) or not abs(np.linalg.norm(joint.axis) - 1) < 1e-6:
            raise InputError("must be a unit vector", f"{where}.axis")
        if not np.isfinite(numbers).all() or (numbers < 0).any() or numbers.max() > 1e6:
            raise InputError("strength and release must be from 0 to 1e6 N", where)
        if not abs(joint.pitch) <= 1:
            raise InputError(f"{joint.pitch} m; must be from -1 to 1", f"{where}.pitch")


def _check_witness(assembly: Assembly) -> None:
    if not assembly.witness:
        return
    removable = sorted(part.name for part in assembly.parts if not part.fixed)
    if sorted(assembly.witness) != removable:
        raise InputError("must name every removable part exactly once", f"{assembly.name}: witness")


def _check_overlap(assembly: Assembly) -> None:
    owners: list[int] = []
    boxes: list[OrientedBox] = []
    for i, part in enumerate(assembly.parts):
        if isinstance(part.shape, Box):
            for box in assembly.body(i):
                owners.append(i)
                boxes.append(box.moved(part.T_world_part))
    if not boxes:
        return
    T = np.array([box.T_frame_box for box in boxes])
    half = np.array([box.half_extents for box in boxes])
    owner = np.array(owners)
    reach = np.einsum("nij,nj->ni", np.abs(T[:, :3, :3]), half)  # half size of the axis-aligned bounds
    lower, upper = T[:, :3, 3] - reach, T[:, :3, 3] + reach
    for a in range(len(boxes)):
        near = (upper[a] > lower[a + 1 :]).all(axis=1) & (lower[a] < upper[a + 1 :]).all(axis=1)
        b = np.nonzero(near & (owner[a + 1 :] != owner[a]))[0] + a + 1
        if not len(b):
            continue
        separation = box_separation(
            np.repeat(T[a : a + 1], len(b), 0), np.repeat(half[a : a + 1], len(b), 0), T[b], half[b]
        )
        worst = int(np.argmin(separation))
        if separation[worst] < -OVERLAP_TOLERANCE:
            first, second = assembly.parts[owner[a]].name, assembly.parts[owner[b[worst]]].name
            raise InputError(
                f"parts {first!r} and {second!r} overlap by {-1e3 * separation[worst]:.2f} mm; at most "
                f"{1e3 * OVERLAP_TOLERANCE:.1f} mm is allowed",
                f"{assembly.name}: parts",
            )
