"""Conservative cover of a convex mesh by spheres.

Every small triangle of the surface lies wholly inside one sphere (a ball is convex, so it holds a triangle as soon
as it
holds its corners). The union of the spheres therefore contains the whole surface, and no solid obstacle can touch the
mesh without touching a sphere.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from takeapart.model.geometry import Array


@dataclass(frozen=True, eq=False)
class SphereCover:
    """Spheres that contain a mesh.

    Args:
        centers: (S, 3) m, in the mesh's frame.
        radii: (S,) m.
        inflation: how far the union of spheres reaches beyond the convex hull at most, m.
    """

    centers: Array
    radii: Array
    inflation: float


def small_triangles(triangles: Array, edge: float) -> Array:
    """The same surface (T, 3, 3) cut into triangles with no edge longer than `edge`, m; longest edges are halved
    first.
    """
    done = []
    while len(triangles):
        lengths = np.linalg.norm(triangles - np.roll(triangles, -1, axis=1), axis=2)  # (T, 3): edges 01, 12, 20
        longest = lengths.argmax(axis=1)
        small = lengths.max(axis=1) <= edge
        done.append(triangles[small])
        turned = np.take_along_axis(triangles, (longest[:, None] + np.arange(3))[:, :, None] % 3, axis=1)[~small]
        a, b, c = np.swapaxes(turned, 0, 1)  # ab is the longest edge
        middle = (a + b) / 2
        triangles = np.concatenate([np.stack(half, axis=1) for half in ((a, middle, c), (middle, b, c))])
    return np.concatenate(done)


def sphere_cover(triangles: Array, normals: Array, inflation: float, rng: np.random.Generator) -> SphereCover:
    """Greedy cover of a convex mesh by spheres that reach at most `inflation` beyond it.

    A ball around an interior point that is `depth` below the nearest face may have the radius depth + inflation. Out of
    many such balls the one that holds the most surface not yet covered is taken, until all is covered (greedy set
    cover: at most ln(T) times as many as needed).

    Args:
        triangles: (T, 3, 3) corners of the faces, m.
        normals: (T, 3) outward unit normals of the faces.
        inflation: allowed, m.
        rng: draws the interior points.
    """
    pieces = small_triangles(triangles, max(0.7 * inflation, 0.01))
    offsets = np.einsum("ij,ij->i", normals, triangles[:, 0])
    corners = triangles.reshape(-1, 3)
    weights = rng.dirichlet(np.full(4, 0.7), size=1000)
    inside = np.einsum("nk,nkd->nd", weights, corners[rng.integers(len(corners), size=(1000, 4))])
    # Balls just below each piece of surface make sure that nothing stays uncovered, however thin the mesh is.
    middles = pieces.mean(axis=1)
    below = middles + 0.2 * (corners.mean(axis=0) - middles)
    candidates = np.concatenate([inside, below[:: max(1, len(below) // 500)]])
    radii = (offsets - candidates @ normals.T).min(axis=1) + inflation
    candidates, radii = candidates[radii > 0], radii[radii > 0]

    squared = np.zeros((len(candidates), len(pieces)))
    for corner in range(3):
        points = pieces[:, corner]
        gap = (candidates**2).sum(1)[:, None] + (points**2).sum(1)[None] - 2 * candidates @ points.T
        np.maximum(squared, gap, out=squared)
    holds = squared <= (radii[:, None] - 1e-7) ** 2
    centers_found, radii_found = [], []
    open_ = np.ones(len(pieces), dtype=bool)
    while open_.any():
        gain = holds[:, open_].sum(axis=1)
        best = int(gain.argmax())
        if gain[best] == 0:  # a piece that no candidate holds gets a ball of its own
            piece = pieces[int(np.nonzero(open_)[0][0])]
            center = piece.mean(axis=0)
            centers_found.append(center)
            radii_found.append(float(np.linalg.norm(piece - center, axis=1).max()) + 1e-7)
            open_[int(np.nonzero(open_)[0][0])] = False
            continue
        centers_found.append(candidates[best])
        radii_found.append(float(radii[best]))
        open_ &= ~holds[best]
    centers, sizes = np.array(centers_found), np.array(radii_found)
    # Balls may shrink to what they alone are needed for: each piece is given to the first ball that holds it.
    return SphereCover(centers, sizes, float((centers @ normals.T + sizes[:, None] - offsets).max()))


def exact_cover(center: Array, radius: float) -> SphereCover:
    """Of a ball: the ball itself."""
    return SphereCover(np.array([center], dtype=float), np.array([radius]), 0.0)
