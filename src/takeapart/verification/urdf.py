"""URDF files as MuJoCo can read them: reduced to the links and joints that matter, before MuJoCo parses them.

MuJoCo makes frames, joints, axes and collision geometry of the text itself. What it cannot do is done here: files with
more in them than one arm or one gripper, joints that mimic others, and meshes in formats that it does not read.
"""

from __future__ import annotations

import hashlib
import re
import xml.etree.ElementTree as ElementTree
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path

import numpy as np

from takeapart.model.description import RobotDescription, RobotFiles
from takeapart.model.errors import InputError

MOVING = {"revolute", "continuous", "prismatic"}
# MuJoCo's defaults for URDF do not fit: fusestatic would merge the gripper into the last arm link, strippath would drop
# the folders of meshes, discardvisual would drop the parts that are not in the gripper at the start.
COMPILER = '<compiler fusestatic="false" strippath="false" discardvisual="false" balanceinertia="true"/>'
INERTIAL = '<inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>'


@dataclass(frozen=True)
class Mimic:
    """A joint that follows another one: position = multiplier * position of the other + offset."""

    joint: str
    follows: str
    multiplier: float
    offset: float


@dataclass(frozen=True)
class UrdfBranch:
    """A part of a URDF, as MuJoCo can read it.

    Args:
        name: of the file, for messages.
        xml: of its links and joints, meshes named as in `assets`.
        assets: content of the mesh files.
        links: with the base first, parents before what hangs on them.
        limits: least and greatest position of every joint that moves by itself, rad or m; infinite where continuous.
        mimics: joints that follow others, each told by one that moves by itself.
    """

    name: str
    xml: str
    assets: Mapping[str, bytes] = field(repr=False)
    links: tuple[str, ...]
    limits: Mapping[str, tuple[float, float]]
    mimics: tuple[Mimic, ...]

    @property
    def joints(self) -> set[str]:
        """Names of all joints that move."""
        return {*self.limits, *(mimic.joint for mimic in self.mimics)}


def _first_line(error: Exception) -> str:
    return str(error).strip().splitlines()[0]


@lru_cache(maxsize=8)
def arm_branch(description: RobotDescription) -> UrdfBranch:
    """The arm without the gripper: all that hangs on its base link. Joints of the file that are not the arm's stand at
    zero.

    Raises:
        InputError: the file cannot be read, or is not the arm that the description says.
    """
    arm, gripper = description.arm, description.gripper
    root, where = _read(arm.files), str(arm.files.urdf)
    tree = _Tree(root, where)
    same_file = arm.files.urdf == gripper.files.urdf
    links = tree.below(arm.base_link, {*arm.left_out, *([gripper.base_link] if same_file else [])})
    if arm.flange_link not in links:
        raise InputError(f"link {arm.flange_link!r} does not hang on {arm.base_link!r}", where)
    chain = [tree.joint_above[link] for link in tree.chain(arm.base_link, arm.flange_link)]
    moving = [str(joint.get("name")) for joint in chain if joint.get("type") in MOVING]
    masters = {mimic.joint for mimic in tree.mimics}
    for name in arm.joints:
        if name not in moving:
            known = ", ".join(moving)
            raise InputError(f"joint {name!r} does not move {arm.flange_link!r}; these do: {known}", where)
    unnamed = [name for name in moving if name not in arm.joints and name not in masters]
    if unnamed:
        raise InputError(f"joint {unnamed[0]!r} moves {arm.flange_link!r}, but the description does not name it", where)
    return _branch(tree, links, set(arm.joints), arm.files)


@lru_cache(maxsize=8)
def gripper_branch(description: RobotDescription) -> UrdfBranch:
    """The gripper: all that hangs on its base link.

    Raises:
        InputError: the file cannot be read, or is not the gripper that the description says.
    """
    gripper = description.gripper
    where = str(gripper.files.urdf)
    tree = _Tree(_read(gripper.files), where)
    links = tree.below(gripper.base_link)
    for link in gripper.finger_links:
        if link not in links:
            raise InputError(f"link {link!r} does not hang on {gripper.base_link!r}", where)
    branch = _branch(tree, links, None, gripper.files)
    for name in gripper.joints:
        if name not in branch.limits:
            known = ", ".join(branch.limits) or "none"
            raise InputError(f"joint {name!r} of the gripper does not move by itself; these do: {known}", where)
    unnamed = [name for name in branch.limits if name not in gripper.joints]
    if unnamed:
        raise InputError(f"joint {unnamed[0]!r} of the gripper is neither set by the opening nor mimics another", where)
    return branch


def _read(files: RobotFiles) -> ElementTree.Element:
    where = str(files.urdf)
    try:
        text = _expanded(files.urdf, where) if files.urdf.suffix == ".xacro" else files.urdf.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"cannot be read: {error}", where) from None
    # Tools write elements like <drake:declare_convex> without saying what the prefix stands for.
    prefixes = set(re.findall(r"[<\s]/?([A-Za-z_][\w.-]*):[\w.-]+(?=[\s=/>])", text))
    unbound = [name for name in sorted(prefixes - {"xmlns", "xml"}) if f"xmlns:{name}=" not in text]
    declared = "".join(f' xmlns:{name}="{name}"' for name in unbound)
    text = re.sub(r"<robot\b", lambda found: found[0] + declared, text, count=1)
    try:
        root = ElementTree.fromstring(text.encode())
    except ElementTree.ParseError as error:
        raise InputError(f"is not XML: {error}", where) from None
    if root.tag != "robot":
        raise InputError(f"begins with <{root.tag}>; a URDF begins with <robot>", where)
    return root


def _expanded(path: Path, where: str) -> str:
    """A xacro file as URDF."""
    try:
        import xacro
    except ImportError:
        raise InputError("is a xacro file; install what expands it with: pip install xacro", where) from None
    try:
        return str(xacro.process_file(str(path)).toxml())
    except Exception as error:  # whatever its macros raise
        raise InputError(f"xacro cannot expand it: {_first_line(error)}", where) from None


class _Tree:
    """Links and joints of a URDF, and how they hang on each other."""

    def __init__(self, root: ElementTree.Element, where: str) -> None:
        self.where = where
        self.links = {str(link.get("name")): link for link in root.findall("link")}
        self.joints = {str(joint.get("name")): joint for joint in root.findall("joint")}
        self.joint_above = {self.end(joint, "child"): joint for joint in self.joints.values()}
        self.mimics = tuple(self._mimics())

    def end(self, joint: ElementTree.Element, which: str) -> str:
        """Name of a joint's parent or child link."""
        found = joint.find(which)
        name = "" if found is None else found.get("link", "")
        if name not in self.links:
            raise InputError(f"joint {joint.get('name')!r} has no {which} link {name!r}", self.where)
        return name

    def below(self, base: str, without: Collection[str] = ()) -> list[str]:
        """The base and all links that hang on it, parents first, but nothing from the links in `without` on."""
        if base not in self.links:
            raise InputError(f"there is no link {base!r}", self.where)
        children: dict[str, list[str]] = {}
        for child, joint in self.joint_above.items():
            children.setdefault(self.end(joint, "parent"), []).append(child)
        order = [base]
        for name in order:
            order += [child for child in children.get(name, []) if child not in without]
            if len(order) > len(self.links):
                raise InputError(f"links hang on each other in a circle below {base!r}", self.where)
        return order

    def chain(self, base: str, end: str) -> list[str]:
        """Links from the one after the base to the end."""
        found = [end]
        while found[0] != base:
            found.insert(0, self.end(self.joint_above[found[0]], "parent"))
        return found[1:]

    def _mimics(self) -> Iterable[Mimic]:
        """Joints that follow others, each told by a joint that follows none."""
        direct: dict[str, Mimic] = {}
        for name, joint in self.joints.items():
            element = joint.find("mimic")
            if element is not None and joint.get("type") in MOVING:
                multiplier, offset = (
                    _number(element, attribute, default, f"{self.where}: joint {name!r}: mimic")
                    for attribute, default in (("multiplier", 1.0), ("offset", 0.0))
                )
                direct[name] = Mimic(name, element.get("joint", ""), multiplier, offset)
        for name, mimic in direct.items():
            seen = {name}
            while mimic.follows in direct:
                if mimic.follows in seen:
                    raise InputError(f"joint {name!r} mimics itself", self.where)
                seen.add(mimic.follows)
                master = direct[mimic.follows]
                multiplier = mimic.multiplier * master.multiplier
                mimic = Mimic(name, master.follows, multiplier, mimic.multiplier * master.offset + mimic.offset)
            if mimic.follows not in self.joints:
                raise InputError(f"joint {name!r} mimics {mimic.follows!r}, which is not there", self.where)
            yield mimic


def _number(element: ElementTree.Element, attribute: str, default: float, where: str) -> float:
    text = element.get(attribute, "")
    try:
        return float(text) if text else default
    except ValueError:
        raise InputError(f"{attribute} is {text!r}; must be a number", where) from None


def _branch(tree: _Tree, links: list[str], moving: set[str] | None, files: RobotFiles) -> UrdfBranch:
    """The named links with the joints between them.

    Args:
        moving: joints that move by themselves; what neither is one of them nor follows one is fixed at zero. None: all.
    """
    meshes = _Meshes(files)
    document = ElementTree.Element("robot", name="robot")
    document.append(ElementTree.fromstring(f"<mujoco>{COMPILER}</mujoco>"))
    for name in links:
        link = ElementTree.SubElement(document, "link", name=name)
        link.append(ElementTree.fromstring(INERTIAL))
        for collision in tree.links[name].findall("collision"):
            _add_collision(link, collision, meshes, f"{tree.where}: link {name!r}")
    limits: dict[str, tuple[float, float]] = {}
    followers = {mimic.joint: mimic for mimic in tree.mimics}
    inside = [str(tree.joint_above[name].get("name")) for name in links[1:]]
    found: list[Mimic] = []
    for name in inside:
        joint = tree.joints[name]
        element = ElementTree.SubElement(document, "joint", name=name, type=joint.get("type", ""))
        for tag in ("parent", "child", "origin", "axis"):
            element.extend(joint.findall(tag))
        if joint.get("type") == "fixed":
            continue
        if joint.get("type") not in MOVING:
            text = f"joint {name!r} is of type {joint.get('type')!r}; known: fixed, {', '.join(sorted(MOVING))}"
            raise InputError(text, tree.where)
        mimic = followers.get(name)
        if mimic is not None and (moving is None or mimic.follows in moving):
            if mimic.follows not in inside:
                raise InputError(
                    f"joint {name!r} mimics {mimic.follows!r}, which is not below {links[0]!r}", tree.where
                )
            found.append(mimic)
            element.set("type", "prismatic" if joint.get("type") == "prismatic" else "continuous")
        elif mimic is None and (moving is None or name in moving):
            limits[name] = _limits(joint, tree.where)
            if joint.get("type") != "continuous":
                element.extend(joint.findall("limit"))
        else:
            element.set("type", "fixed")
    xml = ElementTree.tostring(document, encoding="unicode")
    return UrdfBranch(tree.where, xml, meshes.content, tuple(links), limits, tuple(found))


def _limits(joint: ElementTree.Element, where: str) -> tuple[float, float]:
    if joint.get("type") == "continuous":
        return -np.inf, np.inf
    name, element = joint.get("name"), joint.find("limit")
    if element is None:
        raise InputError(f"joint {name!r} has no limits", where)
    low, high = (_number(element, attribute, 0.0, f"{where}: joint {name!r}") for attribute in ("lower", "upper"))
    if not low < high:
        raise InputError(f"joint {name!r} goes from {low:g} to {high:g}; the lower limit must be less", where)
    return low, high


def _add_collision(link: ElementTree.Element, collision: ElementTree.Element, meshes: _Meshes, where: str) -> None:
    geometry = collision.find("geometry")
    shape = None if geometry is None else next(iter(geometry), None)
    if shape is None:
        raise InputError("a collision element without a shape", where)
    known = ("mesh", "box", "sphere", "cylinder", "capsule")
    if shape.tag not in known:
        raise InputError(f"a shape {shape.tag!r}; known: {', '.join(known)}", where)
    element = ElementTree.SubElement(link, "collision")
    element.extend(collision.findall("origin"))
    holder = ElementTree.SubElement(element, "geometry")
    if shape.tag != "mesh":
        holder.append(shape)
        return
    try:
        scale = [float(value) for value in shape.get("scale", "1 1 1").split()]
    except ValueError:
        scale = []
    scale = scale * 3 if len(scale) == 1 else scale
    if len(scale) != 3 or not np.isfinite(scale).all() or not np.all(scale):
        raise InputError(f"scale {shape.get('scale')!r} of a mesh; must be three numbers that are not 0", where)
    x, y, z = scale
    ElementTree.SubElement(holder, "mesh", filename=meshes.named(shape.get("filename", ""), (x, y, z)))


class _Meshes:
    """Mesh files under names of their own, scaled as the URDF says: MuJoCo reads STL and OBJ itself, everything else
    is rewritten for it."""

    def __init__(self, files: RobotFiles) -> None:
        self.files = files
        self.content: dict[str, bytes] = {}
        self._names: dict[tuple[str, tuple[float, float, float]], str] = {}

    def named(self, uri: str, scale: tuple[float, float, float]) -> str:
        if (uri, scale) not in self._names:
            data, ending = _mesh(self.files.resolve(uri), scale)
            name = hashlib.sha256(data).hexdigest()[:24] + ending  # the gripper's must not be taken for the arm's
            self._names[uri, scale] = name
            self.content[name] = data
        return self._names[uri, scale]


def _mesh(path: Path, scale: tuple[float, float, float]) -> tuple[bytes, str]:
    """Content and ending of a mesh file that MuJoCo reads, scaled."""
    data, ending = path.read_bytes(), path.suffix.lower()
    binary = ending == ".stl" and len(data) >= 84 and len(data) == 84 + 50 * int.from_bytes(data[80:84], "little")
    if scale == (1.0, 1.0, 1.0) and (binary or ending == ".obj"):
        return data, ending
    import trimesh

    try:
        loaded = trimesh.load_scene(path).to_geometry()
    except Exception as error:  # its readers fail in many ways
        raise InputError(f"the mesh cannot be read: {_first_line(error)}", str(path)) from None
    if not isinstance(loaded, trimesh.Trimesh) or not len(loaded.faces):
        raise InputError("holds no triangles", str(path))
    factor = np.array(scale)
    if ending == ".dae":
        unit = re.search(rb'<unit\b[^>]*\bmeter\s*=\s*"([^"]+)"', data)
        factor = factor * (float(unit[1]) if unit else 1.0)
    corners = np.asarray(loaded.vertices, dtype=float) * factor
    faces = np.asarray(loaded.faces)[:, :: 1 if np.prod(factor) > 0 else -1]  # a mirrored mesh turns inside out
    lines = [f"v {x!r} {y!r} {z!r}" for x, y, z in corners.tolist()]
    lines += [f"f {a} {b} {c}" for a, b, c in (faces + 1).tolist()]
    return "\n".join(lines).encode() + b"\n", ".obj"
