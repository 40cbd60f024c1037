"""How thin the walls of a region are: what decides how many cells go through them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import shapely
from numpy.typing import NDArray

from phantomnode.geometry.curves import Region

Floats = NDArray[np.float64]

SAMPLES = 2000
"""Places along all outlines from which a wall is measured."""

PART = 0.02
"""Of the outlines that bound the thinnest wall: a shorter stretch is a detail, no wall."""

PARALLEL = np.cos(np.radians(30.0))
"""Faces of a wall are parallel to within 30 degrees; what meets at a sharper angle is a corner."""

FIRST = 1.0 / 64.0
"""Of the size of the box: how far is looked at first. Far looks at large outlines are dear, and rarely needed."""


def thinnest_wall(regions: Sequence[Region]) -> float:
    """Thickness of the thinnest wall of some regions, m: as thin is at least ``PART`` of their outlines.

    From places along the outlines a ray goes straight into the material; where it comes out through a face that is
    about parallel, the way is the thickness there.

    Parameters
    ----------
    regions : sequence of Region

    Returns
    -------
    float
        Infinite where no two faces are parallel, as of a triangle.
    """
    boxes = np.array([region.box for region in regions])
    size = float(np.max(np.ptp(boxes, axis=(0, 1))))
    chains = [loop.polyline(1e-4 * size) for region in regions for loop in region.loops]
    segments = np.concatenate([np.stack([chain[:-1], chain[1:]], axis=1) for chain in chains])
    segments = segments[np.any(segments[:, 0] != segments[:, 1], axis=1)]
    places, inward = _places(segments)
    tree, inner = shapely.STRtree(shapely.linestrings(segments)), _normals(segments)
    way = FIRST * size
    while True:
        thickness = _ways_through(places, inward, segments, inner, tree, min(way, 2.0 * size))
        if np.mean(np.isfinite(thickness)) >= PART or way >= 2.0 * size:
            return float(np.sort(thickness)[int(PART * len(thickness))])
        way *= 4.0


def _places(segments: Floats) -> tuple[Floats, Floats]:
    """Places (k, 2) evenly along segments (s, 2, 2), m, and the unit directions into the material there."""
    length = np.hypot(*(segments[:, 1] - segments[:, 0]).T)
    until = np.cumsum(length)
    along = (np.arange(SAMPLES) + 0.5) / SAMPLES * until[-1]
    number = np.minimum(np.searchsorted(until, along), len(segments) - 1)
    part = 1.0 - (until[number] - along) / length[number]
    start, end = segments[number, 0], segments[number, 1]
    return start + part[:, None] * (end - start), _normals(segments)[number]


def _normals(segments: Floats) -> Floats:
    """(s, 2) Unit normals on the left of segments, where the material is."""
    along = segments[:, 1] - segments[:, 0]
    return np.asarray(np.column_stack([-along[:, 1], along[:, 0]]) / np.hypot(*along.T)[:, None])


def _ways_through(
    places: Floats, inward: Floats, segments: Floats, inner: Floats, tree: shapely.STRtree, way: float
) -> Floats:
    """(k,) The way of each ray to the first face that it goes out of, m; infinite where it is no wall or farther."""
    rays = shapely.linestrings(np.stack([places, places + way * inward], axis=1))
    ray, hit = tree.query(rays, predicate="intersects")
    facing = np.einsum("ka,ka->k", inward[ray], inner[hit])  # -1: it leaves at a right angle
    leaves = facing < 0.0
    ray, hit, facing = ray[leaves], hit[leaves], facing[leaves]
    off = np.einsum("ka,ka->k", segments[hit, 0] - places[ray], inner[hit])
    distance = off / facing
    first = np.full(len(places), np.inf)
    np.minimum.at(first, ray, distance)
    nearest = distance == first[ray]
    found = np.full(len(places), np.inf)
    parallel = nearest & (facing <= -PARALLEL)
    np.minimum.at(found, ray[parallel], distance[parallel])
    return found
