"""RRT-Connect with many starts and many goals. Kuffner and LaValle, ICRA 2000."""

from __future__ import annotations

import math

import numpy as np

from takeapart.compilation import compiled, compiled_lean
from takeapart.motion.edges import joint_edge_free
from takeapart.motion.scene import Scene
from takeapart.robot.arrays import ArmArrays, Floats, Integers, RandomState
from takeapart.robot.kinematics import squared_distance, wind


@compiled_lean
def next_random(state: RandomState) -> float:
    """Uniform number in [0, 1) from a generator state (1,) of uint64. SplitMix64, Steele et al., OOPSLA 2014."""
    state[0] += np.uint64(0x9E3779B97F4A7C15)
    z = state[0]
    z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    z = z ^ (z >> np.uint64(31))
    return float(z >> np.uint64(11)) / 9007199254740992.0


@compiled_lean
def _nearest(nodes: Floats, count: int, q: Floats) -> int:
    best, found = math.inf, 0
    for k in range(count):
        total = 0.0
        for j in range(len(q)):
            d = nodes[k, j] - q[j]
            total += d * d
        if total < best:
            best, found = total, k
    return found


@compiled_lean
def _nearest_wound(arm: ArmArrays, starts: Floats, q: Floats) -> int:
    """The start (A, n) that a configuration can be wound nearest to."""
    best, found = math.inf, 0
    for k in range(len(starts)):
        total = squared_distance(arm, starts[k], q)
        if total < best:
            best, found = total, k
    return found


@compiled
def rrt_connect(scene: Scene, starts: Floats, goals: Floats, iterations: int, stride: float, seed: int) -> Floats:
    """A free joint path from any start to any goal; goals are wound as near to a start as they can be.

    Joints that can turn further than once round are drawn within half a turn of a start, each start in its turn: every
    pose of the links is there, and the trees do not spread over windings that lead nowhere else.

    Args:
        starts: (A, n) free configurations, rad.
        goals: (B, n) free configurations, rad.
        iterations: random samples at most.
        stride: length of a tree edge, rad.
        seed: of this call's own random numbers.

    Returns:
        (M, n) corners of the path, or (0, n) if none was found.
    """
    n = starts.shape[1]
    capacity = iterations * 8 + len(starts) + len(goals)
    nodes = np.empty((2, capacity, n))
    parent = np.full((2, capacity), -1, np.int32)
    count = np.array([len(starts), len(goals)])
    nodes[0, : count[0]] = starts
    nodes[1, : count[1]] = goals
    if len(scene.arm.turning):
        for g in range(len(goals)):
            wind(scene.arm, goals[g], starts[_nearest_wound(scene.arm, starts, goals[g])], nodes[1, g])
    state = np.array([seed], dtype=np.uint64)
    q, target = np.empty(n), np.empty(n)
    side = 0
    for turn in range(iterations):
        for j in range(n):
            q[j] = scene.arm.lower[j] + (scene.arm.upper[j] - scene.arm.lower[j]) * next_random(state)
        if len(scene.arm.turning):
            wind(scene.arm, q, starts[turn % len(starts)], q)
        near = _nearest(nodes[side], count[side], q)
        distance = math.sqrt(np.sum((nodes[side, near] - q) ** 2))
        if distance > stride:
            for j in range(n):
                q[j] = nodes[side, near, j] + (q[j] - nodes[side, near, j]) * stride / distance
        if count[side] < capacity and joint_edge_free(scene, nodes[side, near], q):
            new = count[side]
            nodes[side, new] = q
            parent[side, new] = near
            count[side] += 1
            # The other tree grows towards the new node as far as it gets.
            other = 1 - side
            near = _nearest(nodes[other], count[other], q)
            while count[other] < capacity:
                distance = math.sqrt(np.sum((nodes[other, near] - q) ** 2))
                reached = distance <= stride
                for j in range(n):
                    part = 1.0 if reached else stride / distance
                    target[j] = nodes[other, near, j] + (q[j] - nodes[other, near, j]) * part
                if not joint_edge_free(scene, nodes[other, near], target):
                    break
                nodes[other, count[other]] = target
                parent[other, count[other]] = near
                near = count[other]
                count[other] += 1
                if reached:
                    first, second = (new, near) if side == 0 else (near, new)
                    return _joined(nodes, parent, first, second)
        side = 1 - side
    return np.empty((0, n))


@compiled
def _joined(nodes: Floats, parent: Integers, first: int, second: int) -> Floats:
    """Path from the root above node `first` of tree 0 to the root above node `second` (the same place) of tree 1."""
    length = 0
    k = first
    while k >= 0:
        length += 1
        k = parent[0, k]
    before = length
    k = parent[1, second]
    while k >= 0:
        length += 1
        k = parent[1, k]
    path = np.empty((length, nodes.shape[2]))
    k = first
    for i in range(before - 1, -1, -1):
        path[i] = nodes[0, k]
        k = parent[0, k]
    k = parent[1, second]
    for i in range(before, length):
        path[i] = nodes[1, k]
        k = parent[1, k]
    return path
