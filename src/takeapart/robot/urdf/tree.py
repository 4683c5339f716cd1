"""What a URDF says, as data: links with their geometry, joints between them, and the poses that follow."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Literal

import numpy as np

from takeapart.model.description import RobotFiles
from takeapart.model.errors import InputError, UnknownNameError
from takeapart.model.geometry import Array

TURNING = ("revolute", "continuous")
KINDS = ("fixed", "revolute", "continuous", "prismatic")
AT_ZERO: Mapping[str, float] = MappingProxyType({})  # values of joints
CONTINUOUS_LIMIT = 2 * math.pi  # rad, of joints that turn without end: every angle twice, so that no path must unwind


@dataclass(frozen=True, eq=False)
class Geometry:
    """A shape that is fixed to a link.

    Args:
        kind: of the shape.
        T_link: (4, 4) pose of the shape in the link's frame.
        size: m; box: edges (x, y, z); cylinder: radius, length along z; sphere: radius; mesh: the factors along
            x, y, z by which it is scaled, without a unit.
        uri: file of a mesh as the URDF names it.
        color: red, green, blue from 0 to 1 as the URDF says; None where it says nothing.
    """

    kind: Literal["box", "cylinder", "sphere", "mesh"]
    T_link: Array
    size: tuple[float, ...]
    uri: str = ""
    color: tuple[float, float, float] | None = None


@dataclass(frozen=True, eq=False)
class Link:
    """A rigid body.

    Args:
        collisions, visuals: its geometry for collisions and for the eye.
        mass: kg; 0 where the URDF says none.
    """

    name: str
    collisions: tuple[Geometry, ...]
    visuals: tuple[Geometry, ...]
    mass: float = 0.0


@dataclass(frozen=True)
class Mimic:
    """The value of a joint follows another one: multiplier * value + offset, rad or m."""

    joint: str
    multiplier: float = 1.0
    offset: float = 0.0


@dataclass(frozen=True, eq=False)
class Joint:
    """A joint between two links.

    Args:
        kind: as the URDF says it; those of `KINDS` can be moved.
        T_parent: (4, 4) pose of the child link in the parent link where the joint is at 0.
        axis: (3,) direction in the child link's frame, of norm 1.
        lower, upper: limits, rad or m; not a number where the URDF says none.
    """

    name: str
    kind: str
    parent: str
    child: str
    T_parent: Array
    axis: Array
    lower: float = math.nan
    upper: float = math.nan
    mimic: Mimic | None = None

    def motion(self, value: float) -> Array:
        """Pose (4, 4) of the child link in where it is at 0, for a value, rad or m."""
        T = np.eye(4)
        if self.kind == "fixed":
            return T
        if self.kind == "prismatic":
            T[:3, 3] = self.axis * value
            return T
        x, y, z = self.axis
        K = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
        T[:3, :3] += math.sin(value) * K + (1 - math.cos(value)) * K @ K  # Rodrigues
        return T


@dataclass(frozen=True, eq=False)
class Urdf:
    """A robot's links and joints; they form a tree.

    Args:
        name: that the file states.
        files: where it was read from, and where its meshes are.
        links, joints: by name, in the order of the file.
    """

    name: str
    files: RobotFiles
    links: Mapping[str, Link]
    joints: Mapping[str, Joint]
    above: Mapping[str, Joint] = field(init=False)
    below: Mapping[str, tuple[Joint, ...]] = field(init=False)

    def __post_init__(self) -> None:
        below: dict[str, list[Joint]] = {name: [] for name in self.links}
        for joint in self.joints.values():
            below[joint.parent].append(joint)
        object.__setattr__(self, "above", {joint.child: joint for joint in self.joints.values()})
        object.__setattr__(self, "below", {name: tuple(found) for name, found in below.items()})

    @property
    def where(self) -> str:
        """For messages."""
        return str(self.files.urdf)

    @property
    def roots(self) -> tuple[str, ...]:
        """Links that hang on no other."""
        return tuple(name for name in self.links if name not in self.above)

    def link(self, name: str) -> Link:
        """A link by its name.

        Raises:
            UnknownNameError: there is none; the message lists them.
        """
        if name not in self.links:
            raise UnknownNameError("link", name, list(self.links), self.where)
        return self.links[name]

    def joint(self, name: str) -> Joint:
        """A joint by its name.

        Raises:
            UnknownNameError: there is none; the message lists them.
        """
        if name not in self.joints:
            raise UnknownNameError("joint", name, list(self.joints), self.where)
        return self.joints[name]

    def limits(self, name: str) -> tuple[float, float]:
        """Lower and upper limit of a joint, rad or m; of one that turns without end: `CONTINUOUS_LIMIT` to both sides.

        Raises:
            InputError: the URDF states none.
        """
        joint = self.joint(name)
        if joint.kind == "continuous" and math.isnan(joint.lower):
            return -CONTINUOUS_LIMIT, CONTINUOUS_LIMIT
        if math.isnan(joint.lower) or math.isnan(joint.upper):
            raise InputError(
                f"joint {name!r} has no limits; a {joint.kind} joint needs <limit lower=... upper=...>", self.where
            )
        if joint.lower > joint.upper:
            raise InputError(f"joint {name!r} has the limits {joint.lower:g} and {joint.upper:g}", self.where)
        return joint.lower, joint.upper

    def path(self, base: str, tip: str) -> tuple[Joint, ...]:
        """Joints from one link down to another.

        Raises:
            InputError: the second does not hang on the first.
        """
        self.link(base)
        self.link(tip)
        found: list[Joint] = []
        link = tip
        while link != base:
            if link not in self.above:
                raise InputError(f"link {tip!r} does not hang on link {base!r}", self.where)
            found.append(self.above[link])
            link = found[-1].parent
        return tuple(reversed(found))

    def subtree(self, link: str, cut: frozenset[str] = frozenset()) -> tuple[str, ...]:
        """A link and all that hang on it, those before these on which they hang.

        Args:
            cut: links that are left out, with all that hangs on them.
        """
        found = [self.link(link).name]
        for name in found:
            found += [joint.child for joint in self.below[name] if joint.child not in cut]
        return tuple(found)

    def fixed_on(self, link: str, cut: frozenset[str] = frozenset()) -> dict[str, Array]:
        """The link itself and all that cannot move relative to it, below it; with the pose (4, 4) in the link's frame.

        Args:
            cut: links that are left out, with all that hangs on them.
        """
        found = {self.link(link).name: np.eye(4)}
        pending = [link]
        for name in pending:
            for joint in self.below[name]:
                if joint.kind == "fixed" and joint.child not in cut:
                    found[joint.child] = found[name] @ joint.T_parent
                    pending.append(joint.child)
        return found

    def value(self, name: str, positions: Mapping[str, float]) -> float:
        """Value of a joint, rad or m: what it mimics decides, then the positions; 0 where they say nothing."""
        joint = self.joint(name)
        if joint.mimic is not None:
            return joint.mimic.multiplier * self.value(joint.mimic.joint, positions) + joint.mimic.offset
        return positions.get(name, 0.0)

    def driver(self, name: str) -> str:
        """The joint that moves a joint: the end of the chain of those that mimic others; often itself."""
        joint = self.joint(name)
        return name if joint.mimic is None else self.driver(joint.mimic.joint)

    def pose(self, base: str, tip: str, positions: Mapping[str, float] = AT_ZERO) -> Array:
        """Pose (4, 4) of a link in the frame of another one above it, for values of joints, rad or m; others are at 0.

        Raises:
            InputError: the second does not hang on the first, or a joint between them is of a kind that is not known.
        """
        T = np.eye(4)
        for joint in reversed(self.path(base, tip)):
            T = self._transform(joint, positions) @ T
        return T

    def poses(self, base: str, positions: Mapping[str, float], cut: frozenset[str] = frozenset()) -> dict[str, Array]:
        """Pose (4, 4) in the frame of a link of this link and of all that hang on it, as `pose`."""
        found = {self.link(base).name: np.eye(4)}
        for link in self.subtree(base, cut)[1:]:
            joint = self.above[link]
            found[link] = found[joint.parent] @ self._transform(joint, positions)
        return found

    def _transform(self, joint: Joint, positions: Mapping[str, float]) -> Array:
        if joint.kind == "fixed":
            return joint.T_parent
        if joint.kind not in KINDS:
            raise InputError(
                f"joint {joint.name!r} is of the type {joint.kind!r}; valid: {', '.join(KINDS)}", self.where
            )
        value = self.value(joint.name, positions)
        return joint.T_parent if value == 0.0 else np.asarray(joint.T_parent @ joint.motion(value))
