"""Tool paths of one or two straight legs, shortest first: most removals need no more, and no search is cheaper."""

from __future__ import annotations

import math

import numpy as np

from takeapart.compilation import compiled
from takeapart.motion.edges import MAXIMUM_ROWS, project_to_point, tool_edge
from takeapart.motion.rrt import next_random
from takeapart.motion.scene import Scene, is_free
from takeapart.robot.arrays import ArmArrays, Flags, Floats, Indices, WorldArrays
from takeapart.robot.grid import line_free
from takeapart.robot.kinematics import forward, squared_distance, wind


@compiled
def joint_distances(arm: ArmArrays, lifted: Floats, goals: Floats) -> Floats:
    """Squared distance (G,) in joint space, rad^2, from each of the goal configurations (G, n) to the nearest of the
    lifted ones (A, n); a goal counts as wound as near as it can be.
    """
    distance = np.empty(len(goals))
    for g in range(len(goals)):
        distance[g] = math.inf
        for s in range(len(lifted)):
            distance[g] = min(distance[g], squared_distance(arm, lifted[s], goals[g]))
    return distance


@compiled
def near_pairs(arm: ArmArrays, lifted: Floats, goals: Floats, each: int) -> Indices:
    """Pairs (P, 2) of a lifted and a goal configuration, `each` goals per lifted one.

    First come all lifted configurations with their nearest goal in joint space, the nearest pair first, then all with
    their second nearest, and so on: neighbours on the same branch of the arm mostly succeed or fail together. A goal
    counts as wound as near as it can be.
    """
    each = min(each, len(goals))
    distance = np.empty((each, len(lifted)))
    goal_of = np.empty((each, len(lifted)), np.int64)
    apart = np.empty(len(goals))
    for s in range(len(lifted)):
        for g in range(len(goals)):
            apart[g] = squared_distance(arm, lifted[s], goals[g])
        for k in range(each):
            nearest = int(np.argmin(apart))
            goal_of[k, s], distance[k, s] = nearest, apart[nearest]
            apart[nearest] = math.inf
    pairs = np.empty((each * len(lifted), 2), np.int64)
    for k in range(each):
        for place, s in enumerate(np.argsort(distance[k])):
            pairs[k * len(lifted) + place, 0], pairs[k * len(lifted) + place, 1] = s, goal_of[k, s]
    return pairs


@compiled
def one_leg(scene: Scene, starts: Floats, ends: Floats, spacing: float) -> Floats:
    """Rows (M, n) of the first tool-straight path from a configuration of (P, n) to that in the same row of another
    (P, n), all of them free; (0, n) if there is none. Ends are wound as near to their starts as they can be.

    Args:
        spacing: see `tool_edge`.
    """
    n = starts.shape[1]
    rows, end = np.empty((MAXIMUM_ROWS, n)), np.empty(n)
    for k in range(len(starts)):
        wind(scene.arm, ends[k], starts[k], end)
        count = tool_edge(scene, starts[k], end, spacing, rows)
        if count:
            path = np.empty((count + 1, n))
            path[0] = starts[k]
            path[1:] = rows[:count]
            return path
    return np.empty((0, n))


@compiled
def bends(
    world: WorldArrays, present: Flags, a: Floats, b: Floats, radius: float, samples: int, longest: float, seed: int
) -> Floats:
    """Points (K, 4) at which a path of two straight legs from a to b can bend: x, y, z and its length, m; shortest
    first.

    Points are drawn from the ellipsoid in which they keep the path short enough (the informed set of Gammell et al.,
    IROS 2014); those are dropped whose legs a small ball around the tool cannot pass.

    Args:
        radius: of a ball that is always inside the held part, m.
        samples: points drawn.
        longest: length of the path at most, m.
        seed: of this call's own random numbers.
    """
    straight = math.sqrt(np.sum((b - a) ** 2))
    longest = min(longest, 2.5 * straight + 0.3)
    if longest <= straight or straight < 1e-6:
        return np.empty((0, 4))
    state = np.array([seed], dtype=np.uint64)
    along = (b - a) / straight
    helper = np.array([0.0, 0.0, 1.0]) if abs(along[2]) < 0.9 else np.array([1.0, 0.0, 0.0])
    side = np.cross(along, helper)
    side /= math.sqrt(np.sum(side**2))
    other = np.cross(along, side)
    middle = 0.5 * (a + b)
    found = np.empty((samples, 4))
    kept = 0
    for _ in range(samples):
        # Lengths are drawn evenly: the short ones, few in volume, are the ones that matter.
        total = straight + (longest - straight) * next_random(state)
        across = 0.5 * math.sqrt(max(total * total - straight * straight, 0.0))
        cosine = 2.0 * next_random(state) - 1.0
        turn = 2.0 * math.pi * next_random(state)
        sine = math.sqrt(1.0 - cosine * cosine)
        point = middle + 0.5 * total * cosine * along + across * sine * (math.cos(turn) * side + math.sin(turn) * other)
        if line_free(world, present, a, point, radius) and line_free(world, present, point, b, radius):
            found[kept, :3] = point
            found[kept, 3] = total
            kept += 1
    return found[:kept][np.argsort(found[:kept, 3])]


@compiled
def two_legs(
    scene: Scene,
    lifted: Floats,
    goals: Floats,
    points: Floats,
    attempts: int,
    shorter_than: float,
    spacing: float,
    seed: int,
) -> Floats:
    """Rows (M, n) of the shortest path of two tool-straight legs that is found; (0, n) if none is.

    Args:
        lifted, goals: free configurations (A, n) and (G, n).
        points: (K, 4) where the path may bend, shortest first, see `bends`; tried in this order, so the first that
            succeeds is the best of them.
        attempts: tries with the arm at most.
        shorter_than: length of the path at most, m.
        spacing: see `tool_edge`.
        seed: of this call's own random numbers.
    """
    n = lifted.shape[1]
    nothing = np.empty((0, n))
    if len(goals) == 0:
        return nothing
    forward(scene.arm, lifted[0], scene.work)
    a = scene.work.p_tool.copy()
    state = np.array([seed], dtype=np.uint64)
    pairs = near_pairs(scene.arm, lifted, goals, 3)
    first, second = np.empty((MAXIMUM_ROWS, n)), np.empty((MAXIMUM_ROWS, n))
    via, goal = np.empty(n), np.empty(n)
    tried = 0
    tried_at = np.full(len(pairs), -1)  # the last point that each pair was tried with
    for k in range(len(points)):
        if points[k, 3] >= shorter_than:
            break
        # A few of the nearest pairs for every point, others for other points.
        for _ in range(3):
            if tried == attempts:
                return nothing
            tried += 1
            pick = int(next_random(state) * len(pairs))
            if tried_at[pick] == k:
                continue  # it would fail as it did
            tried_at[pick] = k
            start = lifted[pairs[pick, 0]]
            wind(scene.arm, goals[pairs[pick, 1]], start, goal)
            share = math.sqrt(np.sum((points[k, :3] - a) ** 2)) / points[k, 3]
            for j in range(n):
                via[j] = start[j] + share * (goal[j] - start[j])
            if not project_to_point(scene, via, points[k, 0], points[k, 1], points[k, 2]) or not is_free(scene, via):
                continue
            count = tool_edge(scene, start, via, spacing, first)
            if count == 0:
                continue
            more = tool_edge(scene, via, goal, spacing, second)
            if more == 0 or 1 + count + more > MAXIMUM_ROWS:
                continue
            path = np.empty((1 + count + more, n))
            path[0] = start
            path[1 : 1 + count] = first[:count]
            path[1 + count :] = second[:more]
            return path
    return nothing
