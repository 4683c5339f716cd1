"""What a motion may touch: the mask that makes a removal valid in other states too."""

from __future__ import annotations

import numpy as np

from takeapart.compilation import compiled, compiled_lean
from takeapart.motion.scene import Scene, set_piece
from takeapart.robot.arrays import Flags, Floats
from takeapart.robot.kernels import LARGEST_MARGIN, collect, collect_placed
from takeapart.robot.kinematics import place, set_still


@compiled
def path_blockers(scene: Scene, rows: Floats, hits: Flags) -> bool:
    """Marks in `hits` (parts + 1,) every owner that the motion through the rows (M, n) may touch.

    A proof for all the others: a piece of motion is checked at its middle with everything padded by as much as it moves
    from there to its ends; pieces that touch something are halved until nothing moves more than a step in them.
    What still touches then counts as hit, so an owner that is passed by at padding and half a step or more is never
    marked, and one that is not marked is never nearer than the padding.

    Returns:
        False if the arm touches itself, or an owner that never leaves.
    """
    near = np.zeros(len(hits), np.uint8)
    place(scene.arm, scene.held, rows[0], scene.work)
    set_still(scene.work)
    if not _settle(scene, hits, near, True):
        return False
    for row in range(1, len(rows)):
        pieces, k = 1, 0
        while True:
            margin = set_piece(scene, rows[row - 1], rows[row], k / pieces, (k + 1) / pieces)
            margin = max(margin, scene.work.group_margin[1])
            last = 2.0 * margin <= scene.step
            if margin <= LARGEST_MARGIN and _settle(scene, hits, near, last):
                k += 1
                while k % 2 == 0 and pieces > 1:
                    k //= 2
                    pieces //= 2
                if k == pieces:
                    break
            elif last:
                return False
            else:
                k *= 2
                pieces *= 2
    return True


@compiled
def configuration_blockers(scene: Scene, configurations: Floats, hits: Flags) -> Flags:
    """Marks in `hits` (K, parts + 1) every owner that each configuration (K, n) touches.

    Returns:
        (K,) whether the arm touches itself.
    """
    folded = np.zeros(len(configurations), np.uint8)
    for k in range(len(configurations)):
        folded[k] = not touches(scene, configurations[k], hits[k])
    return folded


@compiled_lean
def touches(scene: Scene, q: Floats, hits: Flags) -> bool:
    """Marks in `hits` (parts + 1,) every owner that a configuration touches; False if the arm touches itself."""
    return collect(scene.arm, scene.held, scene.world, scene.present, scene.padding, q, scene.work, hits)


@compiled_lean
def _settle(scene: Scene, hits: Flags, near: Flags, last: bool) -> bool:
    """Whether the piece of motion that was set is decided: it touches nothing new; or, at the last size, what it
    touches is marked.
    """
    for i in range(len(hits)):
        near[i] = hits[i]  # what is marked already needs no further look
    free = collect_placed(scene.arm, scene.held, scene.world, scene.present, scene.padding, scene.work, near)
    if not free or near[len(near) - 1]:
        return False
    new = False
    for i in range(len(hits)):
        new = new or near[i] != hits[i]
    if new and last:
        for i in range(len(hits)):
            hits[i] = near[i]
    return last or not new
