"""How far apart two convex bodies are at least: a distance that is proved, not only found.

The algorithm is Gilbert, Johnson, Keerthi: A Fast Procedure for Computing the Distance Between Complex Objects in
Three-Dimensional Space, IEEE Journal of Robotics and Automation 4 (2), 1988. It looks for the point of the difference
of two bodies that is nearest to the origin. Whatever direction it looks in on its way, the smallest coordinate of the
difference along that direction is a lower bound of the distance; the largest of these bounds is what is returned. So
an error of rounding can make the answer smaller, never larger than the distance.
"""

from __future__ import annotations

import math

from takeapart.compilation import compiled_apart, compiled_lean
from takeapart.robot.arrays import ArmArrays, Floats, Workspace

ITERATIONS = 64
ACCURACY = 1e-6  # m, between the bound and the distance where the algorithm ends by itself


@compiled_apart
def separation(
    first: Floats, second: Floats, R: Floats, p: Floats, near: float, enough: float, simplex: Floats
) -> float:
    """Lower bound of the distance of two convex bodies, m; 0 where they touch, or where none could be proved.

    Args:
        first: (V, 3) corners of one body, m.
        second: (W, 3) corners of the other, in a frame of its own.
        R, p: rotation (3, 3) and position (3,), m, of that frame in the frame of the first body.
        near: a distance that is not above this ends the search, m.
        enough: a bound above this ends the search, m.
        simplex: (5, 3) scratch; rows 0 to 3 are points of the difference, row 4 the nearest one to the origin.
    """
    v = simplex[4]
    for i in range(3):  # first direction: from a corner of the second body to one of the first
        v[i] = first[0, i] - p[i] - R[i, 0] * second[0, 0] - R[i, 1] * second[0, 1] - R[i, 2] * second[0, 2]
    count, bound = 0, 0.0
    for _ in range(ITERATIONS):
        norm = math.sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2])
        if norm < 1e-12:
            return bound
        # The corner of the difference first - second that is least along v.
        a = _lowest(first, v[0], v[1], v[2])
        u0 = R[0, 0] * v[0] + R[1, 0] * v[1] + R[2, 0] * v[2]
        u1 = R[0, 1] * v[0] + R[1, 1] * v[1] + R[2, 1] * v[2]
        u2 = R[0, 2] * v[0] + R[1, 2] * v[1] + R[2, 2] * v[2]
        b = _lowest(second, -u0, -u1, -u2)
        for i in range(3):
            simplex[count, i] = (
                first[a, i] - p[i] - R[i, 0] * second[b, 0] - R[i, 1] * second[b, 1] - R[i, 2] * second[b, 2]
            )
        along = simplex[count, 0] * v[0] + simplex[count, 1] * v[1] + simplex[count, 2] * v[2]
        bound = max(bound, along / norm)
        if bound > enough or (count and norm - bound < ACCURACY):
            return bound
        count = _nearest(simplex, count + 1)
        if count == 4 or v[0] * v[0] + v[1] * v[1] + v[2] * v[2] <= near * near:
            return bound
    return bound


@compiled_apart
def body_meets_box(
    arm: ArmArrays, b: int, center: Floats, axes: Floats, half: Floats, w: int, padding: float, work: Workspace
) -> bool:
    """Whether body b of the arm is no further than the padding, m, from box w of arrays of centres (W, 3), axes
    (W, 3, 3) and half sizes (W, 3), or cannot be proved to be.

    The search of `separation`, in the frame of the body. Needs `place`.
    """
    f = arm.body_frame[b]
    R, p, box, simplex = work.R, work.p, work.box, work.simplex
    for j in range(3):
        box[3, j] = 0.0
        for k in range(3):
            box[3, j] += R[f, k, j] * (center[w, k] - p[f, k])
        for i in range(3):
            along = R[f, 0, j] * axes[w, i, 0] + R[f, 1, j] * axes[w, i, 1] + R[f, 2, j] * axes[w, i, 2]
            box[i, j] = half[w, i] * along
    corners = arm.corner[arm.corner_start[b] : arm.corner_start[b + 1]]
    v = simplex[4]
    for j in range(3):
        v[j] = corners[0, j] - box[3, j]
    count = 0
    for _ in range(ITERATIONS):
        norm = math.sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2])
        if norm < 1e-12:
            return True
        a = _lowest(corners, v[0], v[1], v[2])
        for j in range(3):
            simplex[count, j] = corners[a, j] - box[3, j]
        for i in range(3):  # less the corner of the box that is farthest along v
            sign = 1.0 if v[0] * box[i, 0] + v[1] * box[i, 1] + v[2] * box[i, 2] > 0.0 else -1.0
            for j in range(3):
                simplex[count, j] -= sign * box[i, j]
        bound = (simplex[count, 0] * v[0] + simplex[count, 1] * v[1] + simplex[count, 2] * v[2]) / norm
        if bound > padding:
            return False
        if count and norm - bound < ACCURACY:
            return True
        count = _nearest(simplex, count + 1)
        if count == 4 or v[0] * v[0] + v[1] * v[1] + v[2] * v[2] <= padding * padding:
            return True
    return True


@compiled_apart
def bodies_meet(arm: ArmArrays, a: int, b: int, padding: float, work: Workspace) -> bool:
    """Whether two bodies of the arm are no further than the padding, m, from each other, or cannot be proved to be.
    Needs `place`.
    """
    f, g = arm.body_frame[a], arm.body_frame[b]
    R, p, box = work.R, work.p, work.box
    for i in range(3):
        box[3, i] = 0.0
        for k in range(3):
            box[3, i] += R[f, k, i] * (p[g, k] - p[f, k])
        for j in range(3):
            box[i, j] = R[f, 0, i] * R[g, 0, j] + R[f, 1, i] * R[g, 1, j] + R[f, 2, i] * R[g, 2, j]
    first = arm.corner[arm.corner_start[a] : arm.corner_start[a + 1]]
    second = arm.corner[arm.corner_start[b] : arm.corner_start[b + 1]]
    return separation(first, second, box, box[3], padding, padding, work.simplex) <= padding


@compiled_lean
def _lowest(corners: Floats, x: float, y: float, z: float) -> int:
    """The corner of (V, 3) that is least along a direction."""
    best, least = 0, x * corners[0, 0] + y * corners[0, 1] + z * corners[0, 2]
    for a in range(1, len(corners)):
        along = x * corners[a, 0] + y * corners[a, 1] + z * corners[a, 2]
        if along < least:
            best, least = a, along
    return best


@compiled_apart
def _nearest(simplex: Floats, count: int) -> int:
    """Writes the point nearest to the origin of the hull of the first `count` rows to row 4, and moves the fewest rows
    that have it in their hull to the front.

    Returns:
        how many these are; 4 if the origin lies inside, and then nothing is written.
    """
    if count == 4:
        kept = _on_solid(simplex)
    elif count == 3:
        kept = _on_face(simplex, 0, 1, 2)
    elif count == 2:
        kept = _on_edge(simplex, 0, 1)
    else:
        kept = _on_corner(simplex, 0)
    size = 0
    for k in range(count):
        if kept >> k & 1:
            for i in range(3):
                simplex[size, i] = simplex[k, i]
            size += 1
    return size


@compiled_lean
def _on_corner(simplex: Floats, a: int) -> int:
    for i in range(3):
        simplex[4, i] = simplex[a, i]
    return 1 << a


@compiled_apart
def _on_edge(simplex: Floats, a: int, b: int) -> int:
    """As `_nearest` of rows a and b; returns a bit for each row that is kept."""
    along = squared = 0.0
    for i in range(3):
        edge = simplex[b, i] - simplex[a, i]
        along -= edge * simplex[a, i]
        squared += edge * edge
    if along <= 0.0:
        return _on_corner(simplex, a)
    if along >= squared:
        return _on_corner(simplex, b)
    share = along / squared
    for i in range(3):
        simplex[4, i] = simplex[a, i] + share * (simplex[b, i] - simplex[a, i])
    return 1 << a | 1 << b


@compiled_apart
def _on_face(simplex: Floats, a: int, b: int, c: int) -> int:
    """As `_on_edge` of a triangle (Ericson: Real-Time Collision Detection, 2005, Sec. 5.1.5)."""
    ab_a = ac_a = ab_b = ac_b = ab_c = ac_c = 0.0
    for i in range(3):
        ab, ac = simplex[b, i] - simplex[a, i], simplex[c, i] - simplex[a, i]
        ab_a -= ab * simplex[a, i]
        ac_a -= ac * simplex[a, i]
        ab_b -= ab * simplex[b, i]
        ac_b -= ac * simplex[b, i]
        ab_c -= ab * simplex[c, i]
        ac_c -= ac * simplex[c, i]
    of_a = ab_b * ac_c - ab_c * ac_b  # areas, but for a common factor, of the triangles between origin and edges
    of_b = ab_c * ac_a - ab_a * ac_c
    of_c = ab_a * ac_b - ab_b * ac_a
    total = of_a + of_b + of_c
    if of_a > 0.0 and of_b > 0.0 and of_c > 0.0:
        share_b, share_c = of_b / total, of_c / total
        for i in range(3):
            ab, ac = simplex[b, i] - simplex[a, i], simplex[c, i] - simplex[a, i]
            simplex[4, i] = simplex[a, i] + share_b * ab + share_c * ac
        return 1 << a | 1 << b | 1 << c
    return _nearest_edge(simplex, a, b, c)


@compiled_lean
def _nearest_edge(simplex: Floats, a: int, b: int, c: int) -> int:
    """As `_on_face`, of its edges alone."""
    kept, best = 0, math.inf
    x = y = z = 0.0
    for k in range(3):
        found = _on_edge(simplex, b if k == 2 else a, b if k == 0 else c)
        squared = simplex[4, 0] ** 2 + simplex[4, 1] ** 2 + simplex[4, 2] ** 2
        if squared < best:
            kept, best = found, squared
            x, y, z = simplex[4, 0], simplex[4, 1], simplex[4, 2]
    simplex[4, 0], simplex[4, 1], simplex[4, 2] = x, y, z
    return kept


@compiled_lean
def _on_solid(simplex: Floats) -> int:
    """As `_on_face` of a tetrahedron: the nearest of the faces that the origin lies beyond, or all four rows."""
    kept, best = 15, math.inf
    x = y = z = 0.0
    for d in range(4):
        a, b, c = (d + 1) & 3, (d + 2) & 3, (d + 3) & 3
        if not _is_beyond(simplex, a, b, c, d):
            continue
        found = _on_face(simplex, a, b, c)
        squared = simplex[4, 0] ** 2 + simplex[4, 1] ** 2 + simplex[4, 2] ** 2
        if squared < best:
            kept, best = found, squared
            x, y, z = simplex[4, 0], simplex[4, 1], simplex[4, 2]
    simplex[4, 0], simplex[4, 1], simplex[4, 2] = x, y, z
    return kept


@compiled_lean
def _is_beyond(simplex: Floats, a: int, b: int, c: int, d: int) -> bool:
    """Whether the face a, b, c of a tetrahedron lies between the origin and row d, or the tetrahedron is flat."""
    o = simplex[a]
    ux, uy, uz = simplex[b, 0] - o[0], simplex[b, 1] - o[1], simplex[b, 2] - o[2]
    vx, vy, vz = simplex[c, 0] - o[0], simplex[c, 1] - o[1], simplex[c, 2] - o[2]
    nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
    wx, wy, wz = simplex[d, 0] - o[0], simplex[d, 1] - o[1], simplex[d, 2] - o[2]
    height = nx * wx + ny * wy + nz * wz
    flat = 1e-24 * (nx * nx + ny * ny + nz * nz) * (wx * wx + wy * wy + wz * wz)
    return height * height <= flat or height * (nx * o[0] + ny * o[1] + nz * o[2]) > 0.0
