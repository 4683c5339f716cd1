"""The arm in a URDF: its chain, base and flange."""

from __future__ import annotations

from dataclasses import dataclass, replace

from takeapart.model.description import ArmDescription
from takeapart.model.errors import InputError
from takeapart.model.geometry import Array
from takeapart.robot.chain import arm_chain
from takeapart.robot.describe.groups import group, is_gripper, longest_chain
from takeapart.robot.urdf import Urdf

NOT_A_BASE = ("world", "map", "floating", "ground", "dummy")  # parts of names of roots that stand for the room
FLANGES = ("tool0", "end_effector_link", "link_eef", "ee_link", "link_ee", "eef", "tcp", "flange")  # the best first
FEWEST_JOINTS = 3
STANDARD_PAYLOAD = 3.0  # kg


@dataclass(frozen=True)
class FoundArm:
    """What was found.

    Args:
        arm: with home at zero, and without a solver.
        gripper_base: link in the arm's file that carries fingers, on the flange; None where there is none.
    """

    arm: ArmDescription
    gripper_base: str | None


def find_arm(
    urdf: Urdf,
    base: str | None = None,
    flange: str | None = None,
    name: str | None = None,
    payload: float | None = None,
) -> FoundArm:
    """The arm in a URDF.

    Args:
        base, flange: links that are known; found where None.
        name: of the arm; the URDF's where None.
        payload: kg; `STANDARD_PAYLOAD` where None.

    Raises:
        InputError: there is no chain of joints that turn, or one of its joints has no limits.
    """
    chain = longest_chain(urdf)
    if base is not None and flange is not None:
        chain = tuple(joint for joint in urdf.path(base, flange) if joint.kind != "fixed")
    elif flange is not None:
        chain = tuple(j for j in urdf.path(root_of(urdf, flange), flange) if j.kind != "fixed")
    elif base is not None:
        below = set(urdf.subtree(base))
        chain = tuple(joint for joint in chain if joint.child in below)
    if len(chain) < FEWEST_JOINTS:
        raise InputError(
            f"the longest chain of joints that turn has {len(chain)}; an arm has at least {FEWEST_JOINTS}", urdf.where
        )
    last = group(urdf, chain[-1].child)
    hand = _gripper_base(urdf, chain[-1].child) if is_gripper(urdf, last) else None
    base = base or _base(urdf, chain[0].parent)
    flange = flange or _flange(urdf, chain[-1].child, hand)
    arm = ArmDescription(
        name=file_name(name or urdf.name),
        files=urdf.files,
        base_link=base,
        flange_link=flange,
        joints=tuple(joint.name for joint in chain),
        payload=payload or STANDARD_PAYLOAD,
        home=(0.0,) * len(chain),
        left_out=() if hand is None else (hand,),
    )
    arm_chain(urdf, arm)
    return FoundArm(arm, hand)


def file_name(name: str) -> str:
    """As a file may hold it."""
    kept = "".join(letter if letter.isascii() and (letter.isalnum() or letter in "._-") else "-" for letter in name)
    return kept[:64] or "robot"


def root_of(urdf: Urdf, link: str) -> str:
    """The link on which a link hangs in the end."""
    while link in urdf.above:
        link = urdf.above[link].parent
    return link


def _base(urdf: Urdf, link: str) -> str:
    """The first link of the group that a link belongs to, but none that stands for the room around the arm."""
    path = [link]
    while path[0] in urdf.above and urdf.above[path[0]].kind == "fixed":
        path.insert(0, urdf.above[path[0]].parent)
    while len(path) > 1 and not urdf.links[path[0]].collisions and any(w in path[0].lower() for w in NOT_A_BASE):
        path.pop(0)
    return path[0]


def _gripper_base(urdf: Urdf, last: str) -> str:
    """First link with geometry on the way from the arm's last link to where the fingers hang."""
    fingers = group(urdf, last).joints[0].parent
    way = [joint.child for joint in urdf.path(last, fingers)]
    return next((link for link in way if urdf.links[link].collisions), fingers)


def _flange(urdf: Urdf, last: str, hand: str | None) -> str:
    """Where the arm's own gripper hangs; else the frame fixed on the last link that is named like a flange, or the last
    that has no geometry and points away from the arm.
    """
    if hand is not None and hand != last:
        return urdf.above[hand].parent
    frames = {link: T for link, T in urdf.fixed_on(last).items() if not urdf.links[link].collisions}
    for word in FLANGES:
        named = [link for link in frames if word in link.lower()]
        if named:
            return named[-1]
    axis = urdf.above[last].axis
    pointing = [link for link, T in frames.items() if abs(float(T[:3, 2] @ axis)) > 0.99]
    return pointing[-1] if pointing else last


def with_home(arm: ArmDescription, home: Array) -> ArmDescription:
    """The arm with a configuration at rest (n,), rad."""
    return replace(arm, home=tuple(round(float(angle), 6) for angle in home))
