"""How far apart two convex bodies are at least: a distance that is proved, not only found.

The algorithm is Gilbert, Johnson, Keerthi: A Fast Procedure for Computing the Distance Between Complex Objects in
Three-Dimensional Space, IEEE Journal of Robotics and Automation 4 (2), 1988. It looks for the point of the difference
of two bodies that is nearest to the origin. Whatever direction it looks in on its way, the smallest coordinate of the
difference along that direction is a lower bound of the distance; the largest of these bounds is what is returned. So
an error of rounding can make the answer smaller, never larger than the distance.
"""

from __future__ import annotations

import math

import numpy as np

from takeapart.compilation import compiled
from takeapart.robot.arrays import Floats

ITERATIONS = 64
ACCURACY = 1e-6  # m, between the bound and the distance where the algorithm ends by itself


@compiled
def separation(first: Floats, second: Floats, R: Floats, p: Floats, enough: float, simplex: Floats) -> float:
    """Lower bound of the distance of two convex bodies, m; 0 where they touch, or where none could be proved.

    Args:
        first: (V, 3) corners of one body, m.
        second: (W, 3) corners of the other, in a frame of its own.
        R, p: rotation (3, 3) and position (3,), m, of that frame in the frame of the first body.
        enough: a bound above this ends the search, m.
        simplex: (5, 3) scratch; rows 0 to 3 are points of the difference, row 4 the nearest one to the origin.
    """
    v = simplex[4]
    for i in range(3):  # first direction: from the middle of the second body to that of the first
        v[i] = first[:, i].mean() - p[i]
        for j in range(3):
            v[i] -= R[i, j] * second[:, j].mean()
    count, bound = 0, 0.0
    for _ in range(ITERATIONS):
        norm = math.sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2])
        if norm < 1e-12:
            return bound
        # The corner of the difference first - second that is least along v.
        least, at = np.inf, 0
        for a in range(len(first)):
            along = v[0] * first[a, 0] + v[1] * first[a, 1] + v[2] * first[a, 2]
            if along < least:
                least, at = along, a
        u0 = R[0, 0] * v[0] + R[1, 0] * v[1] + R[2, 0] * v[2]
        u1 = R[0, 1] * v[0] + R[1, 1] * v[1] + R[2, 1] * v[2]
        u2 = R[0, 2] * v[0] + R[1, 2] * v[1] + R[2, 2] * v[2]
        most, by = -np.inf, 0
        for b in range(len(second)):
            along = u0 * second[b, 0] + u1 * second[b, 1] + u2 * second[b, 2]
            if along > most:
                most, by = along, b
        most += v[0] * p[0] + v[1] * p[1] + v[2] * p[2]
        bound = max(bound, (least - most) / norm)
        if bound > enough or (count and norm - bound < ACCURACY):
            return bound
        for i in range(3):
            w = first[at, i] - p[i]
            for j in range(3):
                w -= R[i, j] * second[by, j]
            simplex[count, i] = w
        count = _nearest(simplex, count + 1)
        if count == 0 or count == 4:  # the origin lies inside
            return bound
    return bound


@compiled
def _nearest(simplex: Floats, count: int) -> int:
    """Writes the point nearest to the origin of the hull of the first `count` rows to row 4, and keeps the fewest rows
    that have it in their hull.

    Returns:
        how many rows are kept; 0 if nothing could be told.

    All faces are tried: with at most four points these are fifteen, and none is preferred by rounding.
    """
    best, chosen = np.inf, 0
    found = np.zeros(3)
    for face in range(1, 1 << count):
        size = 0
        rows = np.zeros(4, np.int64)
        for k in range(count):
            if face >> k & 1:
                rows[size] = k
                size += 1
        # Weights of the point of the face's plane nearest to the origin: solve E'E x = -E'o by Cramer's rule.
        o = simplex[rows[0]]
        G = np.zeros((3, 3))
        g = np.zeros(3)
        for i in range(size - 1):
            for j in range(size - 1):
                for c in range(3):
                    G[i, j] += (simplex[rows[i + 1], c] - o[c]) * (simplex[rows[j + 1], c] - o[c])
            for c in range(3):
                g[i] -= (simplex[rows[i + 1], c] - o[c]) * o[c]
        x = np.zeros(3)
        if size == 2:
            if G[0, 0] <= 0.0:
                continue
            x[0] = g[0] / G[0, 0]
        elif size == 3:
            determinant = G[0, 0] * G[1, 1] - G[0, 1] * G[1, 0]
            if determinant <= 1e-14 * G[0, 0] * G[1, 1]:
                continue
            x[0] = (g[0] * G[1, 1] - G[0, 1] * g[1]) / determinant
            x[1] = (G[0, 0] * g[1] - g[0] * G[1, 0]) / determinant
        elif size == 4:
            determinant = _determinant(G)
            if determinant <= 1e-14 * G[0, 0] * G[1, 1] * G[2, 2]:
                continue
            for k in range(3):
                other = G.copy()
                other[:, k] = g
                x[k] = _determinant(other) / determinant
        if x.sum() > 1.0 + 1e-12 or x.min() < -1e-12:
            continue
        point = o.copy()
        for i in range(size - 1):
            for c in range(3):
                point[c] += x[i] * (simplex[rows[i + 1], c] - o[c])
        squared = (point * point).sum()
        if squared < best:
            best, chosen = squared, face
            found[:] = point
    size = 0
    for k in range(count):
        if chosen >> k & 1:
            simplex[size] = simplex[k]
            size += 1
    simplex[4] = found
    return size


@compiled
def _determinant(G: Floats) -> float:
    return (
        G[0, 0] * (G[1, 1] * G[2, 2] - G[1, 2] * G[2, 1])
        - G[0, 1] * (G[1, 0] * G[2, 2] - G[1, 2] * G[2, 0])
        + G[0, 2] * (G[1, 0] * G[2, 1] - G[1, 1] * G[2, 0])
    )
