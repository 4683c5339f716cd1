"""Links that cannot move relative to each other, and which joints are a gripper's: the shape of a robot's tree."""

from __future__ import annotations

from dataclasses import dataclass

from takeapart.robot.urdf import Joint, Urdf
from takeapart.robot.urdf.tree import TURNING

DEEPEST_FINGER = 4  # moving joints in a row that a finger has at most


@dataclass(frozen=True)
class Group:
    """Links fixed on each other.

    Args:
        first: on which the others hang.
        links: all, the first among them.
        joints: that move, from one of the links to another group, each with that group's first link.
    """

    first: str
    links: tuple[str, ...]
    joints: tuple[Joint, ...]


def group(urdf: Urdf, first: str) -> Group:
    """The group of a link and of what is fixed on it, below it."""
    links = tuple(urdf.fixed_on(first))
    return Group(first, links, tuple(j for link in links for j in urdf.below[link] if j.kind != "fixed"))


def depth(urdf: Urdf, joint: Joint) -> int:
    """Greatest number of moving joints in a row from a joint on."""
    return 1 + max((depth(urdf, below) for below in group(urdf, joint.child).joints), default=0)


def is_gripper(urdf: Urdf, where: Group) -> bool:
    """Whether fingers hang on a group: at least two short branches, moved by few joints, that others mimic or that
    slide, or that each have a finger's few joints.
    """
    return len(where.joints) >= 2 and all(depth(urdf, joint) <= DEEPEST_FINGER for joint in where.joints)


def longest_chain(urdf: Urdf) -> tuple[Joint, ...]:
    """The most joints in a row that turn and move alone, fingers not among them; empty where there are none."""
    best: tuple[Joint, ...] = ()
    stack: list[tuple[str, tuple[Joint, ...]]] = [(root, ()) for root in urdf.roots]
    while stack:
        first, chain = stack.pop()
        here = group(urdf, first)
        if len(chain) > len(best):
            best = chain
        if is_gripper(urdf, here):
            continue
        for joint in here.joints:
            alone = joint.kind in TURNING and joint.mimic is None
            stack.append((joint.child, (*chain, joint) if alone else ()))
    return best
