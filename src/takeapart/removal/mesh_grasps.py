"""Where a part of any form can be gripped between two flat pads.

Two fingers close along a direction; each pad must lie on enough of the surface, and no finger may reach into the part,
neither closed nor on its way there. Directions come from the part's box and its flat faces, places from a grid around
its centre of mass, so that the grasps depend on the body and hardly on its tessellation. Around each closing direction
the hand approaches every 30 degrees, as far over the part as it has to be and no farther.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from takeapart.model.assembly import Part
from takeapart.model.bounding import flat_directions
from takeapart.model.description import RobotDescription
from takeapart.model.geometry import Array, OrientedBox, Shape, TriangleMesh, area_normals, pose_inverse
from takeapart.removal.candidates import GraspCandidate
from takeapart.removal.contact_maps import (
    ContactMap,
    closings,
    crossings,
    lengths_along,
    lengths_behind,
    pinches,
    touched_areas,
)
from takeapart.removal.spreading import spread_out
from takeapart.robot.arrays import Integers
from takeapart.robot.gripper import gripper_boxes

LEAST_CONTACT = 2e-5  # m^2, of each pad
GIVES_WAY = 0.0005  # m; pads touch what is nearer than this, and fingers may overlap the part by less
MOST_OVERHANG = 0.012  # m; the tool's point stands no farther outside of the part's bounding box
PALM_SLACK = 0.001  # m, that the palm keeps off the part at least
TIP_MARGIN = 0.002  # m, by which the fingers' tips end before the part does, where they reach that far
TURN = math.pi / 6  # between approach directions around a closing direction
SHALLOWER = (0.006, 0.012, 0.018, 0.026, 0.036)  # m, by which the fingers also reach less deep
# Contacts that are looked at along an approach direction: of each of so many widths, by which they differ, m, the
# nearest to the centre of mass, and others spread over the part.
MOST_WIDTHS, ALIKE_WIDTH, NEAREST_CONTACTS, SPREAD_CONTACTS = 4, 0.003, 3, 3
STRIDES = 40  # of pixels along the longest side of a map, where the palm would be
PLACES = 9  # of a direction, along the longer side of the map
PIXELS = 100  # along the longest side of a map
FINEST_PIXEL, COARSEST_PIXEL = 0.0004, 0.0015  # m
WIDTH_STEP = 1e-4  # m; the hand is looked at once for each opening
NEARBY = 3.0  # of the pads' half width; grasps as wide as that are looked for again only further away
LARGE_FLAT, SMALL_FLAT = 0.05, 0.01  # of the surface; flat faces that suggest a closing direction
NEAR, ROUND = math.cos(math.radians(5)), math.cos(math.radians(14))  # of closing directions that are alike
SLOPE = math.cos(math.radians(10))  # surfaces steeper to the closing direction do not suggest it


@dataclass(frozen=True, eq=False)
class MeshGrasps:
    """Grasps of a part, and what is in the way of more.

    Args:
        candidates: the best first, each in both finger orders next to each other.
        narrowest: least distance between two opposite surfaces, m, however wide; infinite where there are none.
        contact: largest area that both pads would have at once, m^2, among those that fit between the fingers.
        blocked: whether there is contact enough, but everywhere a finger would reach into the part.
    """

    candidates: tuple[GraspCandidate, ...]
    narrowest: float
    contact: float
    blocked: bool = False


@dataclass(frozen=True, eq=False)
class _Fingers:
    pad: Array  # (4,) m, see `touched_areas`
    bodies: Array  # (B, 6) m
    palm: float  # m, along the tool's z

    @property
    def pad_area(self) -> float:
        return float((self.pad[1] - self.pad[0]) * (self.pad[3] - self.pad[2]))


def mesh_grasps(part: Part, description: RobotDescription, friction: float) -> MeshGrasps:
    """Grasps of a part whose shape is a mesh, those from above first where they are equally good.

    Args:
        friction: coefficient between a finger's pad and the part.
    """
    down = -part.T_world_part[2, :3]  # world -z in the part's frame
    return _grasps(_ByIdentity(part.shape), tuple(np.round(down, 6).tolist()), description, friction)


class _ByIdentity:
    """A shape as a key: equal shapes are one object."""

    def __init__(self, shape: Shape) -> None:
        self.shape = shape
        self.key = getattr(shape, "hash", None) or id(shape)

    def __hash__(self) -> int:
        return hash(self.key)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _ByIdentity) and self.key == other.key


@lru_cache(maxsize=512)
def _grasps(
    key: _ByIdentity, down: tuple[float, float, float], description: RobotDescription, friction: float
) -> MeshGrasps:
    shape = key.shape
    surface, opening = shape.surface(), description.maximum_opening
    least_cosine = 1 / math.hypot(1, friction)
    narrowest = math.inf
    held = _Held(shape, np.array(down), description, least_cosine)
    normals, areas = _normals(surface)
    for d in _closing_directions(shape, surface, normals, areas):
        axes = _axes_across(d, np.array(down), shape.bounding_box().T_frame_box[:3, :3])
        view = _view(surface, normals, axes)
        places = _places(view, axes @ shape.center_of_mass())
        pairs = pinches(view, places, least_cosine, 6)
        pairs = np.column_stack([pairs, pairs[:, :2], pairs[:, :2]])
        spans = pairs[:, 3] - pairs[:, 2]
        narrowest = min(narrowest, float(spans.min(initial=math.inf)))
        good = held.add(view, axes, pairs[(spans <= opening + 1e-9) & (spans > 1e-4)])
        # Teeth, ribs, slots: pads rest on what stands out beside the place, where nothing that wide is held nearby.
        half_width = float(_fingers(description, 0.0).pad[1])
        pairs = closings(view, places, half_width, WIDTH_STEP, least_cosine)
        pairs = pairs[pairs[:, 3] - pairs[:, 2] <= opening + 1e-9]
        points = view.origin + (pairs[:, :2] + 0.5) * view.pixel
        near = np.linalg.norm(points[:, None] - good[:, :2], axis=2) <= NEARBY * half_width
        alike = np.abs((pairs[:, 3] - pairs[:, 2])[:, None] - good[:, 2]) <= GIVES_WAY
        held.add(view, axes, pairs[~(near & alike).any(axis=1)])
    candidates = spread_out(*held.all())
    return MeshGrasps(candidates, narrowest, held.contact, held.blocked and not candidates)


class _Held:
    """Poses in which two pads hold a part.

    Attributes:
        contact, blocked: see `MeshGrasps`; `blocked` also where there are grasps.
    """

    def __init__(self, shape: Shape, down: Array, description: RobotDescription, least_cosine: float) -> None:
        self._box, self._center, self._down = shape.bounding_box(), shape.center_of_mass(), down
        self._description, self._least_cosine = description, least_cosine
        self._size = float(np.linalg.norm(self._box.half_extents))
        self._found: list[tuple[Array, Array, Array, Array]] = [
            (np.empty((0, 4, 4)), np.empty(0), np.empty(0), np.empty(0))
        ]
        self.contact, self.blocked = 0.0, False

    def all(self) -> tuple[Array, Array, Array, Array]:
        """Poses (K, 4, 4), widths, m, costs and steepness (K,) of all that were added."""
        poses, widths, costs, steep = (np.concatenate(each) for each in zip(*self._found, strict=True))
        return poses, widths, costs, steep

    def add(self, view: ContactMap, axes: Array, pairs: Array) -> Array:
        """Looks for grasps along one closing direction.

        Args:
            axes: rows e1, e2, d.
            pairs: (N, 8), see `closings`.

        Returns:
            (K, 3) m, where they are along e1 and e2, and how wide they are.
        """
        grasps = [np.empty((0, 3))]
        if not len(pairs):
            return grasps[0]
        opening = self._description.maximum_opening
        tries = _tries(view, _by_distance(view, pairs, axes @ self._center), self._description)
        for fingers, rows in _by_width(tries, self._description):
            spread = np.maximum(0.0, (opening - (rows[:, 5] - rows[:, 4])) / 2)
            found = touched_areas(
                view, rows, fingers.pad, fingers.bodies, fingers.palm, spread, GIVES_WAY, self._least_cosine
            )
            touched = found[:, :2].min(axis=1)
            self.contact = max(self.contact, float(touched.max(initial=0.0)))
            self.blocked = self.blocked or bool((touched >= LEAST_CONTACT).any())
            good = (touched >= LEAST_CONTACT) & (found[:, 2] > 0)
            good &= _overhang(self._box, _poses(axes, rows)[:, :3, 3]) <= MOST_OVERHANG
            T = _poses(axes, rows[good])
            widths = np.minimum(opening, np.ceil((rows[good, 5] - rows[good, 4]) / WIDTH_STEP - 1e-3) * WIDTH_STEP)
            levers = np.linalg.norm(np.cross(self._center - T[:, :3, 3], axes[2]), axis=1)
            steep = T[:, :3, 2] @ self._down
            costs = levers / self._size + 0.3 * (1 - touched[good] / fingers.pad_area) + 0.25 * (1 - steep)
            self._found.append((T, widths, costs, steep))
            grasps.append(np.column_stack([rows[good, :2], rows[good, 5] - rows[good, 4]]))
        return np.concatenate(grasps)


def _closing_directions(shape: Shape, surface: TriangleMesh, normals: Array, areas: Array) -> Array:
    """Directions (D, 3) along which fingers may close: of the part's box, every 30 degrees around its axes where there
    is a surface across, and of other flat faces; either way is one."""
    R = shape.bounding_box().T_frame_box[:3, :3]
    turned = []
    for k in range(3):
        for n in (1, 2, 4, 5):
            turned.append(math.cos(n * TURN) * R[:, (k + 1) % 3] + math.sin(n * TURN) * R[:, (k + 2) % 3])
    flats, sizes = flat_directions(surface)
    large, small = sizes >= LARGE_FLAT * areas.sum(), sizes >= max(LEAST_CONTACT, SMALL_FLAT * areas.sum())
    wanted = [(d, NEAR) for d in (*R.T, *flats[large])]
    wanted += [(d, ROUND) for d in (*turned, *flats[small & ~large])]
    found: list[Array] = []
    for k, (d, apart) in enumerate(wanted):
        cosines = normals @ d
        both = min(float(areas[cosines > SLOPE].sum()), float(areas[cosines < -SLOPE].sum()))
        if (k < 3 or both >= LEAST_CONTACT) and all(abs(float(d @ other)) < apart for other in found):
            found.append(d / np.linalg.norm(d))
    return np.array(found).reshape(-1, 3)


def _axes_across(d: Array, down: Array, R: Array) -> Array:
    """Rows e1, e2, d of a right-handed frame, e1 as far downwards as it can be, or along an axis of the part's box."""
    for near in (down, *R.T):
        across = near - (near @ d) * d
        if np.linalg.norm(across) > 0.1:
            e1 = across / np.linalg.norm(across)
            return np.array([e1, np.cross(d, e1), d])
    raise AssertionError("one of three axes is not parallel to a direction")


def _normals(surface: TriangleMesh) -> tuple[Array, Array]:
    """Outward unit normals (T, 3) and areas (T,), m^2."""
    normals = area_normals(surface.corners)
    doubled = np.linalg.norm(normals, axis=1)
    return normals / np.maximum(doubled, 1e-300)[:, None], doubled / 2


def _view(surface: TriangleMesh, normals: Array, axes: Array) -> ContactMap:
    vertices = surface.vertices @ axes.T
    corners, cosines = vertices[surface.triangles], normals @ axes[2]
    low, high = corners.reshape(-1, 3).min(axis=0)[:2], corners.reshape(-1, 3).max(axis=0)[:2]
    pixel = float(np.clip((high - low).max() / PIXELS, FINEST_PIXEL, COARSEST_PIXEL))
    shape = np.ceil((high - low) / pixel).astype(np.int32) + 1
    origin = (low + high) / 2 - shape * pixel / 2
    starts, heights, slopes = crossings(corners, cosines, origin, pixel, shape)
    return ContactMap(origin, pixel, shape, starts, heights, slopes)


def _places(view: ContactMap, center: Array) -> Integers:
    """Pixels (P, 2) on a grid through the centre of mass."""
    step = max(1, int(view.shape.max()) // PLACES)
    middle = np.clip(((center[:2] - view.origin) / view.pixel).astype(np.int32), 0, view.shape - 1)
    rows, columns = (np.arange(middle[k] % step, view.shape[k], step) for k in range(2))
    grid = np.stack(np.meshgrid(rows, columns, indexing="ij"), axis=-1).reshape(-1, 2)
    return np.ascontiguousarray(grid, dtype=np.int32)


def _by_distance(view: ContactMap, pairs: Array, center: Array) -> Array:
    """The contacts by their distance to the centre of mass: (N, 8) position along e1 and e2, heights, positions of the
    two surfaces, m."""
    points, low, high = (view.origin + (pairs[:, k : k + 2] + 0.5) * view.pixel for k in (0, 4, 6))
    distances = np.linalg.norm(points - center[:2], axis=1)
    order = np.lexsort((-(pairs[:, 3] - pairs[:, 2]), np.round(distances, 5)))
    return np.column_stack([points, pairs[:, 2:4], low, high])[order]


def _tries(view: ContactMap, contacts: Array, description: RobotDescription) -> Array:
    """Grasps (K, 6), see `touched_areas`: along each approach direction at some of the contacts (N, 8) that the
    fingers are long enough for, with the contact in the middle of the pads unless the fingers' tips would stand out of
    the part, and with the tips a little before the contact's end."""
    fingers = _fingers(description, round(float(contacts[0, 3] - contacts[0, 2]), 3))
    tip = float(fingers.pad[3])
    angles = TURN * np.arange(round(2 * math.pi / TURN))
    ways = np.column_stack([np.cos(angles), np.sin(angles)])
    places, member = np.unique(contacts[:, :2], axis=0, return_inverse=True)
    stride = max(1, int(view.shape.max()) // STRIDES)
    behind = lengths_behind(view, np.ascontiguousarray(places), ways, float(fingers.pad[1]), stride)[member.ravel()]
    within = behind <= -fingers.palm
    if not within.any():
        within[:1] = True  # what is wrong with the best is said
    chosen, way = np.nonzero(within & _looked_at(contacts[:, 3] - contacts[:, 2], within))
    lengths = lengths_along(view, np.ascontiguousarray(contacts), ways, tip, GIVES_WAY)[chosen, way]
    surfaces, body = lengths.T  # m
    back = tip - surfaces + np.minimum(TIP_MARGIN, surfaces)
    retracts = (surfaces < tip) & (back <= MOST_OVERHANG)
    stays = (body >= tip) | ~retracts
    tries = []
    depths = [(stays, np.zeros_like(back)), (retracts, back)]
    for less in SHALLOWER:  # what stands beside the part may leave room for the fingers' tips alone
        depths.append((surfaces < tip + less, np.where(retracts, back, 0.0) + less))
    for used, offset in depths:
        at = contacts[chosen, :2] - offset[:, None] * ways[way]
        tries.append(np.column_stack([at, ways[way], contacts[chosen, 2:4]])[used])
    return np.concatenate(tries)


def _looked_at(spans: Array, within: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Which contacts (N,), the nearest to the centre of mass first, are looked at along each approach direction (N, W):
    of each of a few widths the nearest, and some all over the part: that which stands in the way elsewhere may leave
    room at a handle or a hub.

    Args:
        spans: (N,) m.
        within: (N, W) whether the palm would be outside of the part.
    """
    found = np.zeros_like(within)
    kinds = np.round(spans / ALIKE_WIDTH).astype(int)
    for kind in list(dict.fromkeys(kinds.tolist()))[:MOST_WIDTHS]:
        for way in range(within.shape[1]):
            members = np.flatnonzero(within[:, way] & (kinds == kind))
            if len(members):
                spread = np.linspace(0, len(members) - 1, SPREAD_CONTACTS + 1).astype(int)
                found[members[:NEAREST_CONTACTS], way] = True
                found[members[spread], way] = True
    return found


def _by_width(tries: Array, description: RobotDescription) -> list[tuple[_Fingers, Array]]:
    """Grasps of about equal width, for which the fingers stand alike."""
    widths = np.round(tries[:, 5] - tries[:, 4], 3)
    return [
        (_fingers(description, width), np.ascontiguousarray(tries[widths == width]))
        for width in np.unique(widths).tolist()
    ]


@lru_cache(maxsize=4096)
def _fingers(description: RobotDescription, width: float) -> _Fingers:
    """Face of the pads and bodies of the fingers in the tool frame, at an opening, m; the fingers mirror each other."""
    gripper = description.gripper
    boxes, _ = gripper_boxes(gripper, width)
    T_tool_base = pose_inverse(gripper.T_base_tool(width))
    rows = []
    for box in boxes:
        corners = box.moved(T_tool_base).corners()
        if corners[:, 1].mean() < 0:
            corners = corners * [1, -1, 1]
        (x0, y0, z0), (x1, y1, z1) = corners.min(axis=0), corners.max(axis=0)
        rows.append([x0, x1, z0, z1, y0 - width / 2, y1 - width / 2])
    bodies = np.unique(np.round(rows, 4), axis=0)  # of both fingers, which mirror each other to less
    face = bodies[np.argmin(np.abs(bodies[:, 4]) - 1e-3 * bodies[:, 3])]
    bodies[:, 4] = np.maximum(bodies[:, 4], 0.0)  # boxes around fingers stand out where the fingers do not
    palm = float(bodies[:, 2].min()) + PALM_SLACK
    return _Fingers(np.ascontiguousarray(face[:4]), np.ascontiguousarray(bodies[bodies[:, 5] > 1e-3]), palm)


def _poses(axes: Array, grasps: Array) -> Array:
    """Poses (K, 4, 4) of the tool in the part's frame."""
    T = np.zeros((len(grasps), 4, 4))
    T[:, :3, 2] = grasps[:, 2:4] @ axes[:2]
    T[:, :3, 1] = axes[2]
    T[:, :3, 0] = np.cross(T[:, :3, 1], T[:, :3, 2])
    T[:, :3, 3] = np.column_stack([grasps[:, :2], (grasps[:, 4] + grasps[:, 5]) / 2]) @ axes
    T[:, 3, 3] = 1.0
    return T


def _overhang(box: OrientedBox, points: Array) -> Array:
    """By how much points (K, 3) stand out of a box, m (K,): along the axis along which it is most."""
    local = (points - box.T_frame_box[:3, 3]) @ box.T_frame_box[:3, :3]
    return np.asarray((np.abs(local) - box.half_extents).max(axis=1))
