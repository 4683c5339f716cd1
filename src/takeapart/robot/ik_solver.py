"""The solver of inverse kinematics for an arm: one of those that the library ssik brings, or one that it makes.

What the library brings is for arms as their makers draw them. Its base and its flange may stand elsewhere than those of
the user's URDF: where they stand is measured at loading, from forward kinematics, and an arm that is another one is
refused. For other arms the library writes a solver once; it is kept in the cache folder.
"""

from __future__ import annotations

import hashlib
import importlib
import importlib.util
import logging
import shutil
import sys
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from importlib.machinery import ModuleSpec, PathFinder
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np

from takeapart.caching import cache_folder
from takeapart.model.errors import InputError, MissingExtraError
from takeapart.model.geometry import Array, pose_inverse

LOGGER = logging.getLogger(__name__)
SAME_FRAME = 1e-9  # m, rad; frames that are no further from each other are one
SAME_ARM = 1e-6  # m, rad; by which the forward kinematics of the same arm differ at most
MEASURED_AT = 24  # configurations

# What the library imports and only its solvers of arms without any structure use: computer algebra, and through the
# second, scipy's signal processing and statistics. It takes longer to import than a small problem takes to plan.
POSTPONED = ("sympy", "mpmath", "ssik.solvers.husty_pfurner.general_6r")


@dataclass(frozen=True, eq=False)
class FlangeSolver:
    """A module of the library for an arm, and where its frames stand.

    Args:
        module: has `solve` and `fk` as the library writes them.
        T_library_base: (4, 4) pose of the arm's base in the library's; None where they are one.
        T_flange_library: (4, 4) pose of the library's flange in the arm's; None where they are one.
    """

    module: ModuleType
    T_library_base: Array | None = None
    T_flange_library: Array | None = None

    def to_library(self, T_base_flange: Array) -> Array:
        """The same pose (4, 4) of the flange in the library's frames."""
        T = T_base_flange if self.T_library_base is None else self.T_library_base @ T_base_flange
        return T if self.T_flange_library is None else T @ self.T_flange_library

    def solve(self, T_base_flange: Array, within_limits: bool) -> list[Array]:
        """Configurations (n,), rad, of the flange at a pose (4, 4) in the base, one for each pose of the links.

        Args:
            within_limits: whether the library looks for those inside its own limits only.
        """
        limits: bool | str = True if within_limits else "wrap"
        T = self.to_library(T_base_flange)
        found = self.module.solve(T, allow_rescue=False, respect_limits=limits, enumerate_windings=False)
        return [solution.q for solution in found]


def brought_solver(name: str, flange: Callable[[Array], Array], joints: int, where: str) -> FlangeSolver:
    """The solver that the library brings for an arm.

    Args:
        name: of the module.
        flange: pose (4, 4) of the arm's flange in its base at a configuration (n,), rad.
        joints: n.
        where: for messages.

    Raises:
        InputError: there is no such module, or it is for another arm.
        MissingExtraError: the library is not there.
    """
    try:
        module = import_solver(name)
    except ImportError as error:
        if importlib.util.find_spec("ssik") is None:
            raise MissingExtraError("inverse kinematics", "", "ssik") from error
        raise InputError(f"there is no module {name!r}; leave it empty to work it out from the URDF", where) from error
    if joints != module.DOF:
        raise InputError(f"{name} is for {module.DOF} joints, the arm has {joints}", where)
    rows = np.random.default_rng(0).uniform(-2.5, 2.5, (MEASURED_AT, joints))
    own = np.array([flange(q) for q in rows])
    other = np.array([np.asarray(module.fk(q)) for q in rows])
    if np.abs(own - other).max() <= SAME_FRAME:
        return FlangeSolver(module)
    T_base_library = _base_of(own, other)
    T_library_flange = pose_inverse(T_base_library @ other[0]) @ own[0]
    miss = float(np.linalg.norm((T_base_library @ other @ T_library_flange - own)[:, :3], axis=1).max())
    if miss > SAME_ARM:
        raise InputError(
            f"{name} is for another arm: wherever its base and flange stand, it misses by {1e3 * miss:.3g} mm; "
            "leave it empty to work it out from the URDF",
            where,
        )
    return FlangeSolver(module, pose_inverse(T_base_library), pose_inverse(T_library_flange))


def _base_of(own: Array, other: Array) -> Array:
    """Pose (4, 4) A with own = A other B for one B, by least squares over poses (K, 4, 4).

    From pose to pose it is A X = Y A, as for a camera on a hand (Park, Martin: Robot Sensor Calibration, IEEE
    Transactions on Robotics and Automation 10 (5), 1994).
    """
    from scipy.spatial.transform import Rotation

    moved = own[1:] @ np.linalg.inv(own[0])
    counterpart = other[1:] @ np.linalg.inv(other[0])
    turns, same_turns = (Rotation.from_matrix(T[:, :3, :3]).as_rotvec() for T in (moved, counterpart))
    # Of a turn the sign is lost at half a turn: those near it say nothing.
    clear = np.linalg.norm(turns, axis=1) < 3.0
    R, _ = Rotation.align_vectors(turns[clear], same_turns[clear])
    A = np.eye(4)
    A[:3, :3] = R.as_matrix()
    left = (moved[:, :3, :3] - np.eye(3)).reshape(-1, 3)
    right = (counterpart[:, :3, 3] @ A[:3, :3].T - moved[:, :3, 3]).ravel()
    A[:3, 3] = np.linalg.lstsq(left, right, rcond=None)[0]
    return A


def made_solver(T_joint: Array, T_last_flange: Array, lower: Array, upper: Array, name: str) -> FlangeSolver:
    """The solver that the library writes for an arm; kept in the cache folder.

    Args:
        T_joint: (n, 3, 4) pose of each joint's frame, at angle zero, in that of the joint before; it turns about z.
        T_last_flange: (4, 4) pose of the flange in the last joint's frame.
        lower, upper: (n,) rad.
        name: of the arm, for messages.

    Raises:
        InputError: the library solves no arm like this.
        MissingExtraError: the library is not there.
    """
    frames, T = [], np.eye(4)
    for step in T_joint:
        T = T @ np.vstack([step, [0, 0, 0, 1]])
        frames.append(T)
    T_flange = T @ T_last_flange
    axes = np.array([frame[:3, 2] for frame in frames])
    points = np.array([np.zeros(3), *(frame[:3, 3] for frame in frames), T_flange[:3, 3]])
    offsets, limits = np.diff(points, axis=0), np.column_stack([lower, upper])
    module = _kept_module(axes, offsets, limits, name)
    # At zero the library's flange is not turned against the base: the product of exponentials.
    T_flange_library = np.eye(4)
    T_flange_library[:3, :3] = T_flange[:3, :3].T
    return FlangeSolver(module, None, T_flange_library)


def _kept_module(axes: Array, offsets: Array, limits: Array, name: str) -> ModuleType:
    try:
        library = import_solver("ssik")
    except ImportError as error:
        raise MissingExtraError("inverse kinematics", "", "ssik") from error
    digest = hashlib.sha256(library.__version__.encode())
    for array in (axes, offsets, limits):
        digest.update(np.ascontiguousarray(array, dtype=float).tobytes())
    folder = cache_folder() / f"solver-1-{digest.hexdigest()[:24]}"
    file = folder / "arm_ik.py"
    if not file.is_file():
        _write_module(library, axes, offsets, limits, name, folder)
    specification = importlib.util.spec_from_file_location(f"takeapart_{folder.name.replace('-', '_')}", file)
    assert specification is not None
    assert specification.loader is not None
    module = importlib.util.module_from_spec(specification)
    specification.loader.exec_module(module)
    return module


def _write_module(library: Any, axes: Array, offsets: Array, limits: Array, name: str, folder: Path) -> None:
    """Writes the folder with the solver, all of it or nothing."""
    if len(axes) not in (6, 7):
        raise InputError(f"it has {len(axes)} joints; inverse kinematics are there for 6 and 7", name)
    code = importlib.import_module("ssik.core.codegen")
    try:
        arm = library.Manipulator.from_axes(axes, offsets, limits=limits)
    except (ValueError, NotImplementedError) as error:
        raise InputError(f"no inverse kinematics for this arm: {str(error).splitlines()[0]}", name) from error
    slow = bool(arm.dispatch_plan.needs_symbolic_precompute)
    # An arm without any structure is no common one; a warning reaches the user of the library and of the command line.
    LOGGER.warning(
        "working out the inverse kinematics of %s, once: %s",
        name,
        "it has no structure that would make this easy, so it takes some minutes" if slow else "about ten seconds",
    )
    folder.parent.mkdir(parents=True, exist_ok=True)
    temporary = Path(tempfile.mkdtemp(prefix=f".{folder.name}-", dir=folder.parent))
    try:
        code.emit_artifact(
            kb=arm.kinbody,
            plan=arm.dispatch_plan,
            module_name="arm_ik",
            output_path=str(temporary / "arm_ik.py"),
            arm_label=name,
        )
        if not folder.exists():
            temporary.rename(folder)
    finally:
        shutil.rmtree(temporary, ignore_errors=True)


class _Postponing:
    """Finds the modules of `POSTPONED` so that they are executed when something of theirs is first used."""

    @staticmethod
    def find_spec(name: str, path: Sequence[str] | None = None, target: ModuleType | None = None) -> ModuleSpec | None:
        spec = PathFinder.find_spec(name, path, target) if name in POSTPONED else None
        if spec is not None and spec.loader is not None:
            spec.loader = importlib.util.LazyLoader(spec.loader)
        return spec


def import_solver(name: str) -> ModuleType:
    """A module of the library, by its full name, without what it imports and does not use.

    Raises:
        ImportError: there is none.
    """
    sys.meta_path.insert(0, _Postponing)
    try:
        return importlib.import_module(name)
    finally:
        sys.meta_path.remove(_Postponing)


def listed_solvers(joints: int) -> list[str]:
    """Names of the modules that the library brings for arms with so many joints.

    Raises:
        MissingExtraError: the library is not there.
    """
    try:
        library = import_solver("ssik")
    except ImportError as error:
        raise MissingExtraError("inverse kinematics", "", "ssik") from error
    return [arm.import_path for arm in library.list_arms() if arm.dof == joints]
