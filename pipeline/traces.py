"""Master segments that follow the displacement of the cut elements they lie in.

Along a straight line through a cell the bilinear shape functions are linear only where the line follows an
edge; along the diagonal of a square they miss the chord between its ends by a quarter. A master surface of
whole segments, straight between their displaced ends, would then push other nodes than the slave points beside
it, which take the shape functions at their own place: the total force errs by several per cent on steep
interfaces, and the pressure is rough. Segments are therefore divided until the chord is near enough; each piece
is a master segment like any other, so that the contact law stays the gradient of an energy.

What the chords still miss is small to a cell but not to a phantom node that hangs on a corner of a fragment: the
pressure there erred by 2e-3. Slave points and the places where a segment is divided are therefore moved, by shape
functions that leave every linear field as it is, so that the sum over the slave points of a segment is the
integral of its shape functions on both sides: a constant pressure then pushes every node with its very part.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from phantomnode.geometry.bilinear import shape, to_local
from phantomnode.geometry.doubling import CutMesh

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

CHORD = 5e-4
"""How far shape functions may be from the chord of a piece: a twentieth of a per cent of a nodal force."""

STRAIGHT = 1e-6
"""Shape functions that are this near to linear along a segment follow an edge: the lattice rounds to 2e-7."""

EXACT = 1e-9
"""Sums of shape functions over slave points that are this near to the integral are left as they are."""

PLACES, WEIGHTS = np.polynomial.legendre.leggauss(5)
"""For the integral: in crooked cells shape functions are rational along a line."""

MOST_PIECES = 8
"""Pieces of a segment at most: across the whole diagonal of a cell shape functions are then within 0.4 %."""


@dataclass(frozen=True)
class Traces:
    """The pieces of some boundary segments, one segment behind the other.

    Attributes
    ----------
    segment : (m,) int64
        The segment of each piece, counted among those that were given.
    part : (m, 2) float64
        Where each piece begins and ends on its segment, 0 to 1.
    start, end : (m, 4) float64
        Shape functions at its ends.
    following : (m,) int64
        The piece that follows, -1 at a free end.
    """

    segment: Ints
    part: Floats
    start: Floats
    end: Floats
    following: Ints


def traces(mesh: CutMesh, chosen: Ints, following: Ints, places: Floats, weights: Floats) -> Traces:
    """Divide boundary segments where shape functions are not linear along them.

    Parameters
    ----------
    mesh : CutMesh
    chosen : (s,) int64
        Numbers in ``mesh.segments``.
    following : (s,) int64
        The one of them that follows each, counted among the chosen ones; -1 at a free end.
    places, weights : (g,) float64
        Where slave points stand on a segment, 0 to 1, and their weights, which sum to one.
    """
    segments = mesh.segments
    corners = mesh.xy[mesh.elements[segments.element[chosen]]]
    ends = shape(segments.local[chosen].reshape(-1, 2)).reshape(-1, 2, 4)
    middle = shape(to_local(corners, segments.ends[chosen].mean(axis=1)))
    bend = np.abs(middle - ends.mean(axis=1)).max(axis=1)
    count = np.clip(np.ceil(np.sqrt(bend / CHORD)), 2, MOST_PIECES).astype(np.int64)
    count[bend < STRAIGHT] = 1

    first = np.concatenate([[0], np.cumsum(count)])
    segment = np.repeat(np.arange(len(chosen)), count)
    number = np.arange(first[-1]) - first[segment]
    part = np.stack([number, number + 1], axis=1) / count[segment, None]
    a, b = np.moveaxis(segments.ends[chosen][segment], 1, 0)
    at = [shape(to_local(corners[segment], (1.0 - t) * a + t * b)) for t in part.T[:, :, None]]
    opens, closes = number == 0, number == count[segment] - 1
    at[0][opens], at[1][closes] = ends[:, 0], ends[:, 1]  # to the bit, as the neighbours have them
    moved = _moved(at, first[:-1], count, mean_shape(corners, segments.ends[chosen]), places, weights)[
        segment
    ]
    at[0][~opens] += moved[~opens]
    at[1][~closes] += moved[~closes]
    inner = np.arange(1, first[-1] + 1)
    outer = np.where(following >= 0, first[following], -1)
    return Traces(segment, part, at[0], at[1], np.where(closes, outer[segment], inner))


def mean_shape(corners: Floats, ends: Floats) -> Floats:
    """(s, 4) Mean of the shape functions of cells with (s, 4, 2) corners along segments of (s, 2, 2) ends."""
    t = 0.5 * (1.0 + PLACES)[:, None]
    points = ends[:, None, 0] + t * (ends[:, None, 1] - ends[:, None, 0])
    n = shape(to_local(np.repeat(corners, len(PLACES), axis=0), points.reshape(-1, 2)))
    return np.asarray(np.einsum("g,sgi->si", 0.5 * WEIGHTS, n.reshape(-1, len(PLACES), 4)))


def sums_squares(places: Floats, weights: Floats) -> bool:
    """Whether slave points sum shape functions exactly where cells are parallelograms; one alone does not."""
    return bool(abs(places**2 @ weights - 1.0 / 3.0) < EXACT)


def _moved(
    at: list[Floats], first: Ints, count: Ints, mean: Floats, places: Floats, weights: Floats
) -> Floats:
    """(s, 4) What the shape functions at the inner ends of the pieces of each segment lack.

    With it their values on the pieces, at the places of slave points, have the mean along the segment.
    """
    scaled = count[:, None] * places
    number = np.minimum(scaled.astype(np.int64), count[:, None] - 1)
    t, piece = scaled - number, first[:, None] + number
    chord = (1.0 - t)[..., None] * at[0][piece] + t[..., None] * at[1][piece]
    inner = ((1.0 - t) * (number > 0) + t * (number < count[:, None] - 1)) @ weights
    missed = mean - np.einsum("g,sgi->si", weights, chord)
    movable = (count > 1) & sums_squares(places, weights)
    return np.where(movable[:, None], missed / np.where(movable, inner, 1.0)[:, None], 0.0)


def balanced(point_shape: Floats, corners: Floats, ends: Floats, places: Floats, weights: Floats) -> Floats:
    """(s, g, 4) Shape functions at the slave points of each segment, moved to have the mean along the segment.

    They are moved in crooked cells only, and by a rule that is right in all others.

    Parameters
    ----------
    point_shape : (s, g, 4) float64
        At the places of the slave points.
    corners, ends : (s, 4, 2), (s, 2, 2) float64, metres
        Of the cells and of the segments.
    places, weights : (g,) float64
        As for :func:`traces`.
    """
    missed = mean_shape(corners, ends) - np.einsum("g,sgi->si", weights, point_shape)
    movable = sums_squares(places, weights) & (np.abs(missed).max(axis=1) > EXACT)
    return point_shape + np.where(movable[:, None], missed, 0.0)[:, None]
