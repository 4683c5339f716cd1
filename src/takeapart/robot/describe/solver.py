"""Whether the library of inverse kinematics brings an arm: told by its forward kinematics, never by its name."""

from __future__ import annotations

import numpy as np

from takeapart.model.description import ArmDescription
from takeapart.model.errors import InputError
from takeapart.model.geometry import Array
from takeapart.robot.ik_solver import brought_solver, listed_solvers
from takeapart.robot.urdf import read_urdf


def prebuilt_solver(arm: ArmDescription) -> str:
    """Module of the library for an arm whose tool it puts where the URDF does, at any configuration, its base and its
    flange standing elsewhere perhaps; empty where there is none.

    Raises:
        MissingExtraError: the library is not there.
    """
    urdf = read_urdf(arm.files)

    def flange(q: Array) -> Array:
        values = dict(zip(arm.joints, np.asarray(q, dtype=float).tolist(), strict=True))
        return urdf.pose(arm.base_link, arm.flange_link, values)

    fitting: list[tuple[bool, bool, str]] = []
    for name in listed_solvers(len(arm.joints)):
        try:
            found = brought_solver(name, flange, len(arm.joints), arm.name)
        except InputError:
            continue
        moved = found.T_library_base is not None or found.T_flange_library is not None
        # Of several that fit, as those of Panda and FR3, the name decides; it never makes one fit.
        fitting.append((arm.name.lower() not in name, moved, name))
    return min(fitting)[2] if fitting else ""
