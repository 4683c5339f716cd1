"""Compiled: what a body looks like along a closing direction, and what two fingers would touch of it there.

A contact map is the body seen along a direction d: for every pixel of a plane across d the heights at which a ray along
d enters and leaves it. Axes e1, e2, d are right-handed.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from takeapart.compilation import compiled
from takeapart.robot.arrays import Floats, Integers

JITTER_U, JITTER_V = 0.0371, 0.0719  # of a pixel; rays through pixels avoid edges


class ContactMap(NamedTuple):
    """A body along a direction."""

    origin: Floats  # (2,) m, of the first pixel's corner along e1 and e2
    pixel: float  # its edge, m
    shape: Integers  # (2,) pixels along e1 and e2
    starts: Integers  # (pixels + 1,) where the crossings of a pixel begin; pixels along e2 come first
    heights: Floats  # (C,) m along d, ascending within a pixel
    cosines: Floats  # (C,) of the outward normal with d: negative where a ray along d enters


@compiled
def crossings(
    corners: Floats, cosines: Floats, origin: Floats, pixel: float, shape: Integers
) -> tuple[Integers, Floats, Floats]:
    """Starts, heights, and cosines of a contact map.

    Args:
        corners: (T, 3, 3) m along e1, e2, and d.
        cosines: (T,) of the triangles' outward normals with d.
    """
    n_u, n_v = shape[0], shape[1]
    starts = np.zeros(n_u * n_v + 1, dtype=np.int32)
    for turn in range(2):  # counts, then fills
        if turn == 1:
            for k in range(n_u * n_v):
                starts[k + 1] += starts[k]
            heights = np.empty(starts[-1])
            slopes = np.empty(starts[-1])
            filled = np.zeros(n_u * n_v, dtype=np.int32)
        for t in range(len(corners)):
            if cosines[t] == 0.0:
                continue
            au, av = corners[t, 0, 0], corners[t, 0, 1]
            bu, bv = corners[t, 1, 0] - au, corners[t, 1, 1] - av
            cu, cv = corners[t, 2, 0] - au, corners[t, 2, 1] - av
            doubled = bu * cv - bv * cu
            if doubled == 0.0:
                continue
            low_u = min(corners[t, 0, 0], corners[t, 1, 0], corners[t, 2, 0])
            high_u = max(corners[t, 0, 0], corners[t, 1, 0], corners[t, 2, 0])
            low_v = min(corners[t, 0, 1], corners[t, 1, 1], corners[t, 2, 1])
            high_v = max(corners[t, 0, 1], corners[t, 1, 1], corners[t, 2, 1])
            first_u = max(0, int(np.floor((low_u - origin[0]) / pixel - 0.5 - JITTER_U)))
            last_u = min(n_u - 1, int(np.floor((high_u - origin[0]) / pixel + 0.5)))
            first_v = max(0, int(np.floor((low_v - origin[1]) / pixel - 0.5 - JITTER_V)))
            last_v = min(n_v - 1, int(np.floor((high_v - origin[1]) / pixel + 0.5)))
            for i in range(first_u, last_u + 1):
                u = origin[0] + (i + 0.5 + JITTER_U) * pixel - au
                for j in range(first_v, last_v + 1):
                    v = origin[1] + (j + 0.5 + JITTER_V) * pixel - av
                    b = (u * cv - v * cu) / doubled
                    c = (bu * v - bv * u) / doubled
                    if b < 0.0 or c < 0.0 or b + c > 1.0:
                        continue
                    k = i * n_v + j
                    if turn == 0:
                        starts[k + 1] += 1
                        continue
                    height = (
                        corners[t, 0, 2]
                        + b * (corners[t, 1, 2] - corners[t, 0, 2])
                        + c * (corners[t, 2, 2] - corners[t, 0, 2])
                    )
                    at = starts[k] + filled[k]
                    filled[k] += 1
                    while at > starts[k] and heights[at - 1] > height:
                        heights[at], slopes[at] = heights[at - 1], slopes[at - 1]
                        at -= 1
                    heights[at], slopes[at] = height, cosines[t]
    return starts, heights, slopes


@compiled
def pinches(view: ContactMap, places: Integers, least_cosine: float, most: int) -> Floats:
    """Where two fingers could close on each other: of each pixel (P, 2) the pairs of an entered and a left surface
    whose normals lie in the friction cones, the widest first.

    Returns:
        (N, 4): the pixel, and the heights of the two surfaces, m.
    """
    found = np.empty((len(places) * most, 4))
    count = 0
    for p in range(len(places)):
        k = places[p, 0] * view.shape[1] + places[p, 1]
        first, last, taken = view.starts[k], view.starts[k + 1], 0
        for span in range(last - first - 1, 0, -1):
            for a in range(first, last - span):
                b = a + span
                if taken < most and view.cosines[a] <= -least_cosine and view.cosines[b] >= least_cosine:
                    found[count, 0], found[count, 1] = places[p, 0], places[p, 1]
                    found[count, 2], found[count, 3] = view.heights[a], view.heights[b]
                    count += 1
                    taken += 1
    return found[:count]


@compiled
def closings(view: ContactMap, places: Integers, half_width: float, alike: float, least_cosine: float) -> Floats:
    """Where flat pads come to rest that close from outside of the body: around each pixel (P, 2) that has any of it,
    within a half width, m, what stands out most on both sides, if its normals lie in the friction cones.

    Args:
        alike: m; of what stands out as far as that, the nearest to the pixel counts.

    Returns:
        (N, 8): the pixel, the heights of the two surfaces, m, and the pixels where they are.
    """
    found = np.empty((len(places), 8))
    count = 0
    reach = int(np.ceil(half_width / view.pixel))
    for p in range(len(places)):
        i, j = places[p, 0], places[p, 1]
        if view.starts[i * view.shape[1] + j] == view.starts[i * view.shape[1] + j + 1]:
            continue
        low, high, near_low, near_high = np.inf, -np.inf, np.inf, np.inf
        cosine_low, cosine_high = 0.0, 0.0
        for turn in range(2):  # how far it stands out, then where
            for a in range(max(0, i - reach), min(view.shape[0], i + reach + 1)):
                for b in range(max(0, j - reach), min(view.shape[1], j + reach + 1)):
                    k = a * view.shape[1] + b
                    first, last = view.starts[k], view.starts[k + 1] - 1
                    apart = np.hypot(a - i, b - j)
                    if first > last or apart * view.pixel > half_width:
                        continue
                    if turn == 0:
                        low, high = min(low, view.heights[first]), max(high, view.heights[last])
                        continue
                    if view.heights[first] <= low + alike and apart < near_low:
                        near_low, cosine_low = apart, view.cosines[first]
                        found[count, 4], found[count, 5] = a, b
                    if view.heights[last] >= high - alike and apart < near_high:
                        near_high, cosine_high = apart, view.cosines[last]
                        found[count, 6], found[count, 7] = a, b
        if cosine_low <= -least_cosine and cosine_high >= least_cosine:
            found[count, 0], found[count, 1], found[count, 2], found[count, 3] = i, j, low, high
            count += 1
    return found[:count]


@compiled
def lengths_along(view: ContactMap, contacts: Floats, ways: Floats, most: float, tolerance: float) -> Floats:
    """How far each contact (N, 8), position along e1 and e2, two heights and the positions of the surfaces there, goes
    on along each of directions (W, 2), m, at most: (N, W, 2), first both surfaces, then any of the body between."""
    lengths = np.empty((len(contacts), len(ways), 2))
    for n in range(len(contacts)):
        low, high = contacts[n, 2] - tolerance, contacts[n, 3] + tolerance
        for w in range(len(ways)):
            length, surfaces, touches = 0.0, 0.0, True
            while length < most:
                if not _crosses(view, contacts[n, 0], contacts[n, 1], ways[w], length, low, high):
                    break
                for side in range(2):
                    at, height = 4 + 2 * side, contacts[n, 2 + side]
                    touches = touches and _crosses(
                        view,
                        contacts[n, at],
                        contacts[n, at + 1],
                        ways[w],
                        length,
                        height - tolerance,
                        height + tolerance,
                    )
                length += view.pixel
                if touches:
                    surfaces = length
            lengths[n, w, 0], lengths[n, w, 1] = min(surfaces, most), min(length, most)
    return lengths


@compiled
def _crosses(view: ContactMap, u: float, v: float, way: Floats, length: float, low: float, high: float) -> bool:
    """Whether a surface is crossed between two heights, m, at a length along a way from a position."""
    i = int(np.floor((u + length * way[0] - view.origin[0]) / view.pixel))
    j = int(np.floor((v + length * way[1] - view.origin[1]) / view.pixel))
    if not (0 <= i < view.shape[0] and 0 <= j < view.shape[1]):
        return False
    for c in range(view.starts[i * view.shape[1] + j], view.starts[i * view.shape[1] + j + 1]):
        if low <= view.heights[c] <= high:
            return True
    return False


@compiled
def lengths_behind(view: ContactMap, contacts: Floats, ways: Floats, half_width: float, stride: int) -> Floats:
    """How far the body reaches behind each contact (N, 2), position along e1 and e2, against each of directions (W, 2),
    in a strip of a half width, m: (N, W), at every so manieth pixel."""
    lengths = np.zeros((len(contacts), len(ways)))
    for i in range(0, view.shape[0], stride):
        u = view.origin[0] + (i + 0.5) * view.pixel
        for j in range(0, view.shape[1], stride):
            k = i * view.shape[1] + j
            if view.starts[k] == view.starts[k + 1]:
                continue
            v = view.origin[1] + (j + 0.5) * view.pixel
            for n in range(len(contacts)):
                ru, rv = u - contacts[n, 0], v - contacts[n, 1]
                for w in range(len(ways)):
                    if abs(rv * ways[w, 0] - ru * ways[w, 1]) <= half_width:
                        lengths[n, w] = max(lengths[n, w], -ru * ways[w, 0] - rv * ways[w, 1])
    return lengths


@compiled
def _holds(view: ContactMap, k: int, low: float, high: float) -> bool:
    """Whether there is material between two heights in a pixel."""
    depth = 0
    before = 0.0
    for c in range(view.starts[k], view.starts[k + 1]):
        height = view.heights[c]
        if depth > 0 and before < high and height > low:
            return True
        depth += 1 if view.cosines[c] < 0 else -1
        if low < height < high:
            return True
        before = height
    return False


@compiled
def touched_areas(
    view: ContactMap,
    grasps: Floats,
    pad: Floats,
    bodies: Floats,
    palm: float,
    spread: Floats,
    tolerance: float,
    least_cosine: float,
) -> Floats:
    """What the fingers touch in each of K grasps.

    Args:
        grasps: (K, 6): the tool's position along e1 and e2, m, its approach direction along e1 and e2, and the heights
            of the two pads' faces, m.
        pad: (4,) ends of the pads' faces along the tool's x, and along its z, m.
        bodies: (B, 6) of one finger, each a box: its ends along x and z, how far from the face it begins and ends, m.
        palm: the tool's z at which the palm begins, m; between and beside the fingers nothing may be there.
        spread: (K,) by which each finger opens further before it is let down along z, m.
        tolerance: to which pads give way, m.

    Returns:
        (K, 3): area of the part within the tolerance of the lower face, and of the upper, m^2; 1 where neither finger
        reaches into the part deeper than the tolerance, neither closed nor on its way down along z, opened.
    """
    result = np.zeros((len(grasps), 3))
    pixel = view.pixel
    grown = pixel / 2
    reach = 0.0
    for x in pad[:2]:
        for z in pad[2:]:
            reach = max(reach, np.hypot(x, z))
    for b in range(len(bodies)):
        for x in bodies[b, :2]:
            for z in bodies[b, 2:4]:
                reach = max(reach, np.hypot(x, z))
    for g in range(len(grasps)):
        u0, v0, a_u, a_v, low, high = grasps[g]
        free = True
        below, above = 0, 0
        for i in range(view.shape[0]):
            ru = view.origin[0] + (i + 0.5 + JITTER_U) * pixel - u0
            first, last = 0, view.shape[1] - 1
            if abs(a_u) > 1e-6:  # only where |x| is in reach
                one, other = (-reach - pixel + a_v * ru) / a_u, (reach + pixel + a_v * ru) / a_u
                first = max(first, int(np.floor((min(one, other) + v0 - view.origin[1]) / pixel)) - 1)
                last = min(last, int(np.floor((max(one, other) + v0 - view.origin[1]) / pixel)) + 1)
            elif abs(a_v * ru) > reach + pixel:
                continue
            for j in range(first, last + 1):
                k = i * view.shape[1] + j
                if view.starts[k] == view.starts[k + 1]:
                    continue
                rv = view.origin[1] + (j + 0.5 + JITTER_V) * pixel - v0
                z = ru * a_u + rv * a_v
                x = ru * -a_v + rv * a_u
                if z > reach + pixel or abs(x) > reach + pixel:
                    continue
                if z < palm - grown and pad[0] <= x <= pad[1]:
                    free = False
                if pad[0] <= x <= pad[1] and pad[2] <= z <= pad[3]:
                    touches_low, touches_high = False, False
                    for c in range(view.starts[k], view.starts[k + 1]):
                        if view.cosines[c] <= -least_cosine and abs(view.heights[c] - low) <= tolerance:
                            touches_low = True
                        if view.cosines[c] >= least_cosine and abs(view.heights[c] - high) <= tolerance:
                            touches_high = True
                    below += touches_low
                    above += touches_high
                if not free:
                    continue  # how much the pads touch is told all the same
                first_height, last_height = view.heights[view.starts[k]], view.heights[view.starts[k + 1] - 1]
                if first_height >= low - tolerance and last_height <= high + tolerance:
                    continue  # nothing outside of the two faces
                for b in range(len(bodies)):
                    if not bodies[b, 0] - grown <= x <= bodies[b, 1] + grown or z > bodies[b, 3] + grown:
                        continue
                    start, stop = bodies[b, 4], bodies[b, 5]
                    if z >= bodies[b, 2] - grown and (
                        _holds(view, k, low - stop, low - start - tolerance)
                        or _holds(view, k, high + start + tolerance, high + stop)
                    ):
                        free = False
                    start, stop = start + spread[g], stop + spread[g]
                    if _holds(view, k, low - stop, low - start - tolerance) or _holds(
                        view, k, high + start + tolerance, high + stop
                    ):
                        free = False
                    if not free:
                        break
        result[g, 0], result[g, 1] = below * pixel**2, above * pixel**2
        result[g, 2] = 1.0 if free else 0.0
    return result
