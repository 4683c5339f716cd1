"""Reading a URDF file: what is wrong with it is found first and told in one line, then yourdfpy parses what is left.

Only <link> and <joint> directly inside <robot> count: those inside <transmission>, <gazebo> and <ros2_control> are
other things of the same name. Elements and attributes with a prefix (drake:, xacro:) are left out; the prefix need not
be bound.
"""

from __future__ import annotations

import hashlib
import io
import math
import xml.etree.ElementTree as ElementTree
from functools import lru_cache
from pathlib import Path
from typing import Any
from xml.parsers import expat

import numpy as np

from takeapart.model.description import RobotFiles
from takeapart.model.errors import InputError
from takeapart.model.geometry import Array
from takeapart.robot.urdf.keeping import keep_parsed, kept_parsed
from takeapart.robot.urdf.tree import Geometry, Joint, Link, Mimic, Urdf

MAXIMUM_BYTES = 32 * 2**20
MAXIMUM_LINKS = 2000
MAXIMUM_DEPTH = 64  # of elements in each other
LARGEST = 1e6  # of any number: m, rad, kg, factors
KEPT = {
    "link": ("visual", "collision"),
    "visual": ("origin", "geometry"),
    "collision": ("origin", "geometry"),
    "geometry": ("box", "cylinder", "sphere", "mesh"),
    "joint": ("origin", "parent", "child", "axis", "limit", "mimic"),
}
SHAPES = {"box": ("size",), "cylinder": ("radius", "length"), "sphere": ("radius",), "mesh": ("filename",)}


def read_urdf(files: RobotFiles) -> Urdf:
    """The robot of a URDF file, or of a xacro file if the package `xacro` is installed.

    Meshes are not looked at: `RobotFiles.resolve` finds them when they are needed.

    Raises:
        InputError: one line that says what is wrong where, and what would be valid.
    """
    where = str(files.urdf)
    content = _expanded(files.urdf, where) if files.urdf.suffix == ".xacro" else _content(files.urdf, where)
    return _read(files.urdf, tuple(sorted(files.packages.items())), content, hashlib.sha256(content).hexdigest())


@lru_cache(maxsize=16)
def _read(path: Path, packages: tuple[tuple[str, Path], ...], content: bytes, digest: str) -> Urdf:
    where = str(path)
    root = _element_tree(content, where)
    masses = {str(link.get("name")): _mass(link, where) for link in root.findall("link")}
    colors = _colors(root)
    _check(root, where)
    known = kept_parsed(digest)
    if known is None:
        import yourdfpy  # takes trimesh along

        tree = io.BytesIO(ElementTree.tostring(_cleaned(root)))
        parsed = yourdfpy.URDF.load(tree, build_scene_graph=False, load_meshes=False).robot
        links = {link.name: _link(link, masses[link.name], colors) for link in parsed.links}
        joints = {joint.name: _joint(joint) for joint in parsed.joints}
        known = parsed.name, links, joints
        keep_parsed(digest, *known)
    found = Urdf(known[0], RobotFiles(path, dict(packages)), known[1], known[2])
    _check_tree(found)
    return found


def _content(path: Path, where: str) -> bytes:
    try:
        with path.open("rb") as file:
            content = file.read(MAXIMUM_BYTES + 1)
    except FileNotFoundError:
        raise InputError("there is no such file", where) from None
    except OSError as error:
        raise InputError(f"cannot be read: {(error.strerror or str(error)).lower()}", where) from None
    if len(content) > MAXIMUM_BYTES:
        raise InputError(f"is larger than {MAXIMUM_BYTES >> 20} MiB, the most that is read", where)
    return content


def _expanded(path: Path, where: str) -> bytes:
    """A xacro file as URDF."""
    _content(path, where)
    try:
        import xacro
    except ImportError:
        raise InputError(
            "is a xacro file, which the package 'xacro' expands to URDF; install it with: pip install xacro", where
        ) from None
    try:
        return str(xacro.process_file(str(path)).toxml()).encode()
    except (xacro.XacroException, expat.ExpatError, OSError, ValueError) as error:
        raise InputError(f"xacro cannot expand it: {' '.join(str(error).split())[:300]}", where) from None


class _Builder:
    """Elements without prefixes from what expat finds; it knows the line of each."""

    def __init__(self, where: str) -> None:
        self.where = where
        self.lines: dict[ElementTree.Element, int] = {}
        self.root: ElementTree.Element | None = None
        self.parser = expat.ParserCreate()
        self.parser.StartElementHandler = self._start
        self.parser.EndElementHandler = self._end
        self.parser.EntityDeclHandler = self._entity
        self._open: list[ElementTree.Element | None] = []

    def _start(self, tag: str, attributes: dict[str, str]) -> None:
        parent = self._open[-1] if self._open else None
        if len(self._open) >= MAXIMUM_DEPTH:
            raise InputError(f"elements are nested deeper than {MAXIMUM_DEPTH} levels", self.where)
        if ":" in tag or (self._open and parent is None):
            self._open.append(None)
            return
        element = ElementTree.Element(tag, {key: value for key, value in attributes.items() if ":" not in key})
        element.set("line", str(self.parser.CurrentLineNumber))
        if parent is None:
            self.root = element
        else:
            parent.append(element)
        self._open.append(element)

    def _end(self, tag: str) -> None:
        self._open.pop()

    def _entity(self, *arguments: object) -> None:
        raise InputError("declares an entity; a URDF needs none, and none is read", self.where)


def _element_tree(content: bytes, where: str) -> ElementTree.Element:
    """The <robot> element; every element has its line as an attribute."""
    builder = _Builder(where)
    try:
        builder.parser.Parse(content, True)
    except expat.ExpatError as error:
        cause = expat.errors.messages[error.code]
        raise InputError(f"not XML: {cause} (line {error.lineno}, column {error.offset + 1})", where) from None
    except (ValueError, LookupError) as error:  # an encoding that Python does not know
        raise InputError(f"not XML: {error}", where) from None
    root = builder.root
    if root is None or root.tag != "robot":
        found = f"its outermost element is <{root.tag}>" if root is not None else "it has no element"
        raise InputError(f"not a URDF: {found}; must be <robot>", where)
    return root


# ---- what is wrong with it


def _check(root: ElementTree.Element, where: str) -> None:
    links, joints = root.findall("link"), root.findall("joint")
    if not links:
        raise InputError("has no link; a robot needs one", where)
    if max(len(links), len(joints)) > MAXIMUM_LINKS:
        raise InputError(f"{len(links)} links and {len(joints)} joints; at most {MAXIMUM_LINKS} are read", where)
    names: set[str] = set()
    for link in links:
        _named(link, names, where)
        for shape in [*link.findall("visual"), *link.findall("collision")]:
            _check_origin(shape, f"link {link.get('name')!r}", where)
            _check_geometry(shape, f"link {link.get('name')!r}", where)
    names = set()
    for joint in joints:
        _named(joint, names, where)
        _check_joint(joint, where)


def _named(element: ElementTree.Element, names: set[str], where: str) -> None:
    name = element.get("name")
    if not name:
        raise InputError(f"the <{element.tag}> on line {element.get('line')} has no name; every one needs it", where)
    if name in names:
        raise InputError(f"two elements <{element.tag}> have the name {name!r}; names must differ", where)
    names.add(name)


def _check_joint(joint: ElementTree.Element, where: str) -> None:
    what = f"joint {joint.get('name')!r}"
    if not joint.get("type"):
        raise InputError(f"{what} (line {joint.get('line')}) has no type", where)
    for end in ("parent", "child"):
        element = joint.find(end)
        if element is None or not element.get("link"):
            raise InputError(f'{what} (line {joint.get("line")}) has no <{end} link="...">', where)
    _check_origin(joint, what, where)
    axis = joint.find("axis")
    if axis is not None and joint.get("type") != "fixed":
        direction = _numbers(axis, "xyz", 3, what, where, "1 0 0")
        if np.linalg.norm(direction) < 1e-9:
            raise InputError(f"{what}: the axis is {axis.get('xyz')!r}; it must have a direction", where)
    elif axis is not None and axis.get("xyz") is None:
        axis.set("xyz", "1 0 0")
    limit = joint.find("limit")
    if limit is not None:
        for key in ("lower", "upper", "effort", "velocity"):
            if limit.get(key) is not None:
                _numbers(limit, key, 1, what, where, largest=math.inf)
    mimic = joint.find("mimic")
    if mimic is not None:
        if not mimic.get("joint"):
            raise InputError(f"{what} mimics a joint without a name", where)
        _numbers(mimic, "multiplier", 1, what, where, "1")
        _numbers(mimic, "offset", 1, what, where, "0")


def _check_origin(element: ElementTree.Element, what: str, where: str) -> None:
    origin = element.find("origin")
    if origin is not None:
        _numbers(origin, "xyz", 3, what, where, "0 0 0")
        _numbers(origin, "rpy", 3, what, where, "0 0 0")


def _check_geometry(element: ElementTree.Element, what: str, where: str) -> None:
    geometry = element.find("geometry")
    shapes = [] if geometry is None else list(geometry)
    if len(shapes) != 1 or shapes[0].tag not in SHAPES:
        found = ", ".join(f"<{shape.tag}>" for shape in shapes) or "nothing"
        raise InputError(
            f"{what} has a <{element.tag}> (line {element.get('line')}) whose geometry is {found}; "
            "must be one box, cylinder, sphere or mesh",
            where,
        )
    shape = shapes[0]
    for key in SHAPES[shape.tag]:
        if shape.get(key) is None:
            raise InputError(f"{what} has a {shape.tag} (line {shape.get('line')}) without {key}", where)
        if key == "filename":
            continue
        if not (_numbers(shape, key, 3 if key == "size" else 1, what, where) > 0).all():
            raise InputError(f"{what} has a {shape.tag} with {key} {shape.get(key)!r}; must be above 0", where)
    if shape.tag == "mesh" and shape.get("scale") is not None:
        factors = _numbers(shape, "scale", 0, what, where)
        if len(factors) not in (1, 3) or not factors.all():
            raise InputError(
                f"{what} has a mesh with the scale {shape.get('scale')!r}; must be one or three numbers other than 0",
                where,
            )


def _numbers(
    element: ElementTree.Element,
    key: str,
    count: int,
    what: str,
    where: str,
    standard: str | None = None,
    largest: float = LARGEST,
) -> Array:
    """So many finite numbers (any if 0) of an attribute; the standard is put where there is none."""
    text = element.get(key, standard)
    if text is None:
        raise InputError(f"{what}: <{element.tag}> on line {element.get('line')} has no {key}", where)
    element.set(key, text.replace(",", " "))
    try:
        found = np.array([float(word) for word in text.replace(",", " ").split()])
    except ValueError:
        found = np.array([math.nan])
    if (count and len(found) != count) or not len(found) or not (np.isfinite(found) & (np.abs(found) <= largest)).all():
        valid = f"{count} finite numbers" if count > 1 else "a finite number"
        raise InputError(
            f"{what}: {key} of <{element.tag}> on line {element.get('line')} is {text[:60]!r}; must be {valid}", where
        )
    return found


def _mass(link: ElementTree.Element, where: str) -> float:
    element = link.find("inertial/mass")
    if element is None or element.get("value") is None:
        return 0.0
    return float(_numbers(element, "value", 1, f"link {link.get('name')!r}", where)[0])


def _check_tree(urdf: Urdf) -> None:
    where = urdf.where
    parents: dict[str, str] = {}
    for joint in urdf.joints.values():
        for link in (joint.parent, joint.child):
            if link not in urdf.links:
                raise InputError(f"joint {joint.name!r} names the link {link!r}, which is not there", where)
        if joint.child in parents:
            raise InputError(
                f"link {joint.child!r} hangs on two joints, {parents[joint.child]!r} and {joint.name!r}; "
                "links must form a tree",
                where,
            )
        parents[joint.child] = joint.name
        if joint.mimic is not None and joint.mimic.joint not in urdf.joints:
            raise InputError(f"joint {joint.name!r} mimics {joint.mimic.joint!r}, which is not there", where)
    reached = {link for root in urdf.roots for link in urdf.subtree(root)}
    if len(reached) < len(urdf.links):
        caught = next(name for name in urdf.links if name not in reached)
        raise InputError(f"link {caught!r} hangs on itself; links must form a tree", where)
    for name in urdf.joints:
        seen, joint = {name}, urdf.joints[name]
        while joint.mimic is not None:
            if joint.mimic.joint in seen:
                raise InputError(f"joint {name!r} mimics itself through {joint.name!r}", where)
            joint = urdf.joints[joint.mimic.joint]
            seen.add(joint.name)


# ---- what is left


def _cleaned(root: ElementTree.Element) -> ElementTree.Element:
    """Only what is needed, as yourdfpy expects it."""
    found = ElementTree.Element("robot", {"name": root.get("name") or "robot"})
    for element in root:
        if element.tag in ("link", "joint"):
            found.append(_copy(element))
    return found


def _copy(element: ElementTree.Element) -> ElementTree.Element:
    found = ElementTree.Element(element.tag, {key: value for key, value in element.attrib.items() if key != "line"})
    found.extend(_copy(child) for child in element if child.tag in KEPT.get(element.tag, ()))
    return found


def _colors(root: ElementTree.Element) -> dict[str, tuple[float, float, float]]:
    """Of materials by their names, and of the visual elements of links by ``LINK/NUMBER``."""
    found: dict[str, tuple[float, float, float]] = {}
    for material in root.iter("material"):
        if (color := _color(material)) is not None and material.get("name"):
            found.setdefault(str(material.get("name")), color)
    for link in root.findall("link"):
        for number, visual in enumerate(link.findall("visual")):
            material_ = visual.find("material")
            if material_ is None:
                continue
            own = _color(material_) or found.get(str(material_.get("name")))
            if own is not None:
                found[f"{link.get('name')}/{number}"] = own
    return found


def _color(material: ElementTree.Element) -> tuple[float, float, float] | None:
    element = material.find("color")
    try:
        values = [float(word) for word in (element.get("rgba", "") if element is not None else "").split()]
    except ValueError:
        return None  # a colour is no reason to refuse a robot
    if len(values) < 3 or not all(0 <= value <= 1 for value in values):
        return None
    red, green, blue = values[:3]
    return red, green, blue


def _link(link: Any, mass: float, colors: dict[str, tuple[float, float, float]]) -> Link:
    looks = (_geometry(visual, colors.get(f"{link.name}/{number}")) for number, visual in enumerate(link.visuals))
    return Link(link.name, tuple(_geometry(element, None) for element in link.collisions), tuple(looks), mass)


def _geometry(element: Any, color: tuple[float, float, float] | None) -> Geometry:
    T = np.eye(4) if element.origin is None else np.asarray(element.origin, dtype=float)
    shape = element.geometry
    if shape.box is not None:
        return Geometry("box", T, tuple(float(edge) for edge in shape.box.size), color=color)
    if shape.cylinder is not None:
        return Geometry("cylinder", T, (float(shape.cylinder.radius), float(shape.cylinder.length)), color=color)
    if shape.sphere is not None:
        return Geometry("sphere", T, (float(shape.sphere.radius),), color=color)
    scale = 1.0 if shape.mesh.scale is None else shape.mesh.scale
    factors = tuple(float(factor) for factor in np.broadcast_to(np.asarray(scale, dtype=float), 3))
    return Geometry("mesh", T, factors, shape.mesh.filename, color)


def _joint(joint: Any) -> Joint:
    axis = np.asarray(joint.axis, dtype=float)
    norm = float(np.linalg.norm(axis))
    mimic = joint.mimic
    follows = None
    if mimic is not None:
        multiplier = 1.0 if mimic.multiplier is None else float(mimic.multiplier)
        follows = Mimic(mimic.joint, multiplier, 0.0 if mimic.offset is None else float(mimic.offset))
    return Joint(
        name=joint.name,
        kind=joint.type,
        parent=joint.parent,
        child=joint.child,
        T_parent=np.eye(4) if joint.origin is None else np.asarray(joint.origin, dtype=float),
        axis=axis / norm if norm > 0 else np.array([1.0, 0.0, 0.0]),
        lower=_limit(joint, "lower"),
        upper=_limit(joint, "upper"),
        mimic=follows,
    )


def _limit(joint: Any, side: str) -> float:
    value = getattr(joint.limit, side) if joint.limit is not None else None
    return math.nan if value is None else float(value)
