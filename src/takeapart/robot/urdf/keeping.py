"""What yourdfpy found in a URDF, kept in the cache folder by the digest of the file's content: importing it, with all
that it takes along, takes longer than a small plan to make.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

import numpy as np

from takeapart.robot.kept import keep, kept
from takeapart.robot.urdf.tree import Geometry, Joint, Link, Mimic

VERSION = 1  # of what is written; another one is not read


def keep_parsed(digest: str, name: str, links: Mapping[str, Link], joints: Mapping[str, Joint]) -> None:
    """Keeps a robot's name, links and joints under the digest of the file that they were read from."""
    document = {"name": name, "links": [asdict(each) for each in links.values()]}
    document["joints"] = [asdict(each) for each in joints.values()]
    text = json.dumps(document, default=lambda array: array.tolist())
    keep(_place(digest), np.frombuffer(text.encode(), np.uint8))


def kept_parsed(digest: str) -> tuple[str, dict[str, Link], dict[str, Joint]] | None:
    """A robot's name, links and joints by the digest of its file; None if they are not known, or damaged."""
    found = kept(_place(digest))
    if found is None or found.dtype != np.uint8:
        return None
    try:
        document = json.loads(found.tobytes())
        links = {each["name"]: _link(each) for each in document["links"]}
        joints = {each["name"]: _joint(each) for each in document["joints"]}
        return str(document["name"]), links, joints
    except (ValueError, KeyError, TypeError):
        return None


def _place(digest: str) -> str:
    return f"urdf-{VERSION}-{digest[:24]}"


def _geometry(values: Mapping[str, Any]) -> Geometry:
    color = values["color"]
    size = tuple(values["size"])
    return Geometry(**{**values, "T_link": np.array(values["T_link"]), "size": size, "color": color and tuple(color)})


def _link(values: Mapping[str, Any]) -> Link:
    shapes = {name: tuple(map(_geometry, values[name])) for name in ("collisions", "visuals")}
    return Link(**{**values, **shapes})


def _joint(values: Mapping[str, Any]) -> Joint:
    mimic = values["mimic"]
    arrays = {name: np.array(values[name]) for name in ("T_parent", "axis")}
    return Joint(**{**values, **arrays, "mimic": Mimic(**mimic) if mimic else None})
