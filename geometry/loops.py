"""Pieces of curves into chains, closed chains into regions; what had to be mended on the way is listed."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from phantomnode.geometry.branches import outlined
from phantomnode.geometry.curves import Curve, Geometry, diagonal
from phantomnode.geometry.findings import Finding, named, notes, place
from phantomnode.geometry.nesting import sort_out

Floats = NDArray[np.float64]

Key = tuple[float, ...]

GAPS = (1e-9, 1e-6, 1e-4)
"""Gaps between ends that are closed, over the drawing's diagonal, the smallest first: of 52 real drawings 47
close at 1e-9, two need 1e-6 and three 1e-4. The first is rounding; the others are listed."""


@dataclass(frozen=True)
class Chains:
    """Pieces joined at their ends.

    Attributes
    ----------
    closed, open : tuple of Curve
    findings : tuple of Finding
        What was mended or left out on the way.
    """

    closed: tuple[Curve, ...]
    open: tuple[Curve, ...]
    findings: tuple[Finding, ...] = ()

    @property
    def notes(self) -> tuple[str, ...]:
        """The findings in words, in metres."""
        return notes(self.findings, "m")


def assemble(pieces: Sequence[Curve], sources: Sequence[str] = (), gap: float | None = None) -> Geometry:
    """Loose pieces as regions (closed chains, nested) and open curves.

    Parameters
    ----------
    pieces : sequence of Curve
    sources : sequence of str, optional
        The entity of the file that each piece comes from, in words, for the findings.
    gap : float, m, optional
        Ends nearer than this are joined; found by :data:`GAPS` unless given.

    Returns
    -------
    Geometry
        Outlines that cross are among the curves, and the findings say so.
    """
    size = diagonal(pieces)
    chains = join(pieces, sources, gap)
    loops, rest, branched = outlined(chains.open, GAPS[1] * size)
    closed, twice = _distinct_loops([*chains.closed, *map(_named, loops)], GAPS[0] * size)
    regions, tangled, wrong = sort_out(closed)
    findings = named((*chains.findings, *twice, *branched, *wrong), pieces, sources)
    return Geometry(regions, (*map(_named, rest), *tangled), findings=findings)


def join(pieces: Sequence[Curve], sources: Sequence[str] = (), gap: float | None = None) -> Chains:
    """Join pieces whose ends meet into chains, closing gaps up to the largest of :data:`GAPS`, or the one given.

    Where three or more ends meet nothing says which two belong together: chains end there (two loops that
    touch in a point are still two loops).
    """
    size = diagonal(pieces)
    findings: list[Finding] = []
    chains = _distinct(pieces, sources or [""] * len(pieces), GAPS[0] * size, findings)
    closed: list[Curve] = []
    for tolerance in [level * size for level in GAPS] if gap is None else [GAPS[0] * size, gap]:
        chains, gaps = _joined(chains, tolerance)
        closed += [chain for chain in chains if chain.closed]
        chains = [chain for chain in chains if not chain.closed]
        findings += [found for found in gaps if found.size > GAPS[0] * size]
    return Chains(tuple(map(_named, closed)), tuple(map(_named, chains)), tuple(findings))


def _named(chain: Curve) -> Curve:
    """The chain under the name of its pieces, where they agree."""
    return Curve(
        chain.points, chain.bulges, chain.names, chain.names[0] if len(set(chain.names)) == 1 else ""
    )


def _distinct(
    pieces: Sequence[Curve], sources: Sequence[str], tolerance: float, findings: list[Finding]
) -> list[Curve]:
    """The pieces without those of no length and without repetitions, which are listed.

    Open pieces are compared line by line and arc by arc; closed ones are outlines, compared later as wholes (one
    may run along another one, and is then told to).
    """
    kept: list[Curve] = []
    seen: set[Key] = set()
    for piece, source in zip(pieces, sources, strict=True):
        who = (source,) if source else ()
        if float(np.sum(piece.lengths)) <= tolerance:
            findings.append(Finding("short", place(piece.points[0]), who))
        elif piece.closed:
            kept.append(piece)
        else:
            keys = _keys(piece, tolerance)
            fresh = np.array([key not in seen for key in keys])
            if not np.all(fresh):
                findings.append(Finding("twice", place(piece.points[int(np.argmin(fresh))]), who))
            kept += _runs(piece, fresh)
            seen.update(keys)
    return kept


def _runs(piece: Curve, keep: NDArray[np.bool_]) -> list[Curve]:
    """The stretches of a chain whose lines and arcs are kept."""
    if np.all(keep):
        return [piece]
    edges = np.flatnonzero(np.diff(np.concatenate([[False], keep, [False]])))
    return [
        Curve(piece.points[a : b + 1], piece.bulges[a:b], piece.names[a:b], piece.name)
        for a, b in edges.reshape(-1, 2)
    ]


def _keys(curve: Curve, tolerance: float) -> list[Key]:
    """Each line or arc rounded to about ten tolerances: the same for two that lie on each other."""
    grid = 10.0 * tolerance
    points = (np.round(curve.points / grid) + 0.0).tolist()
    bulges = (np.round(curve.bulges, 6) + 0.0).tolist()
    ways = zip(points[:-1], points[1:], bulges, strict=True)
    return [min((*a, *b, bulge), (*b, *a, 0.0 - bulge)) for a, b, bulge in ways]


def _distinct_loops(loops: Sequence[Curve], tolerance: float) -> tuple[list[Curve], list[Finding]]:
    """The loops without those of which every line and arc is that of another one."""
    kept, findings = [], []
    seen: set[frozenset[Key]] = set()
    for loop in loops:
        key = frozenset(_keys(loop, tolerance))
        if key in seen:
            findings.append(Finding("twice", place(loop.points[0])))
        else:
            kept.append(loop)
        seen.add(key)
    return kept, findings


def _joined(chains: list[Curve], tolerance: float) -> tuple[list[Curve], list[Finding]]:
    """Chains joined where exactly two ends lie within the tolerance; and the gaps that were closed."""
    if not chains:
        return [], []
    ends = np.array([chain.points[[0, -1]] for chain in chains]).reshape(
        -1, 2
    )  # end 2k and 2k + 1 of chain k
    cluster = _clusters(ends, tolerance)
    for k, chain in enumerate(chains):
        # A chain shorter than a few gaps would vanish if its ends were joined to each other.
        if (
            cluster[2 * k] == cluster[2 * k + 1]
            and not chain.closed
            and float(np.sum(chain.lengths)) < 10.0 * tolerance
        ):
            cluster[2 * k + 1] = cluster.max() + 1
    partner = _partners(cluster)
    corner = {int(p): ends[k] for k, p in reversed(list(enumerate(cluster)))}
    gaps = [
        Finding("gap", place(0.5 * (end + corner[int(p)])), (), float(np.hypot(*(end - corner[int(p)]))))
        for p, end in zip(cluster, ends, strict=True)
    ]
    result = []
    used = np.zeros(len(chains), dtype=bool)
    free = [end for end in range(len(ends)) if end not in partner]
    free.sort(key=lambda end: end % 2)  # an open chain runs as its pieces do, whatever their order
    for start in [*free, *range(0, len(ends), 2)]:
        if not used[start // 2]:
            result.append(_walk(chains, start, partner, cluster, corner, used))
    return result, gaps


def _clusters(ends: Floats, tolerance: float) -> NDArray[np.int64]:
    """(k,) The cluster of each end: ends within the tolerance of one another share one."""
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components
    from scipy.spatial import cKDTree

    pairs = cKDTree(ends).query_pairs(tolerance, output_type="ndarray")
    graph = coo_matrix((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(len(ends), len(ends)))
    return np.asarray(connected_components(graph, directed=False)[1], dtype=np.int64)


def _partners(cluster: NDArray[np.int64]) -> dict[int, int]:
    """The other end of each end that meets exactly one other."""
    at = defaultdict(list)
    for end, where in enumerate(cluster):
        at[int(where)].append(end)
    pairs = [tuple(found) for found in at.values() if len(found) == 2]
    return {a: b for pair in pairs for a, b in (pair, pair[::-1])}


def _walk(
    chains: list[Curve], start: int, partner: dict[int, int], cluster: NDArray[np.int64], corner: dict[int, Floats],
    used: NDArray[np.bool_],
) -> Curve:  # fmt: skip
    """The chain that begins at one end and runs from partner to partner until it ends or closes."""
    points = [corner[int(cluster[start])][None]]
    bulges: list[Floats] = []
    names: list[str] = []
    end: int | None = start
    while end is not None and not used[end // 2]:
        used[end // 2] = True
        chain = chains[end // 2] if end % 2 == 0 else chains[end // 2].reversed()
        points += [chain.points[1:-1], corner[int(cluster[end ^ 1])][None]]
        bulges.append(chain.bulges)
        names += chain.names
        end = partner.get(end ^ 1)
    return Curve(np.vstack(points), np.concatenate(bulges), tuple(names))
