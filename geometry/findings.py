"""What was mended in a drawing and what cannot be, entity by entity, with its place."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from phantomnode.geometry.curves import Curve
from phantomnode.geometry.units import metres

Kind = Literal["gap", "short", "twice", "branch", "crossing", "self", "overlap"]

HEALED: dict[Kind, str] = {
    "short": "curves of no length were left out",
    "twice": "curves drawn twice were taken once",
    "gap": "gaps between ends of curves were closed",
    "branch": "outlines were found among curves that branch: the outer boundary counts, what lies within it is kept "
    "as curves",
}
"""What was done about each kind that can be healed."""

WRONG: dict[Kind, str] = {
    "self": "an outline crosses or touches itself",
    "crossing": "two outlines cross or share a stretch",
    "overlap": "the two sides of a contact pair overlap",
}
"""What cannot be healed."""

MOST_TOLD = 3
"""Findings of one kind that a note tells; ``inspect`` tells them all."""


@dataclass(frozen=True)
class Finding:
    """One thing that was mended, or that cannot be.

    Attributes
    ----------
    kind : str
        A key of :data:`HEALED` or :data:`WRONG`.
    at : (float, float)
        Its place, metres.
    entities : tuple of str
        The entities of the file that are concerned, in words.
    size : float
        Width of a gap, metres; 0 for all others.
    """

    kind: Kind
    at: tuple[float, float]
    entities: tuple[str, ...] = ()
    size: float = 0.0

    @property
    def wrong(self) -> bool:
        """Whether it cannot be healed."""
        return self.kind in WRONG

    def told(self, unit: str, word: str | None = None) -> str:
        """Place and entities in words, with lengths in the unit of the file, called by another word if given."""
        factor, unit = metres(unit), word or unit
        x, y = self.at[0] / factor + 0.0, self.at[1] / factor + 0.0
        width = f"{self.size / factor:.2g} {unit} wide " if self.size else ""
        who = f": {' and '.join(self.entities)}" if self.entities else ""
        return f"{width}at ({x:.8g}, {y:.8g}) {unit}{who}"


def notes(findings: Sequence[Finding], unit: str, most: int = MOST_TOLD) -> tuple[str, ...]:
    """One sentence for each kind of finding that was healed, with the first few places, the widest gaps first."""
    said = []
    for kind, what in HEALED.items():
        found = sorted((f for f in findings if f.kind == kind), key=lambda f: -f.size)
        if found:
            listed = "; ".join(finding.told(unit) for finding in found[:most])
            more = f"; and {len(found) - most} more" if len(found) > most else ""
            said.append(f"{len(found)} {what} ({listed}{more})")
    return tuple(said)


def complaint(findings: Sequence[Finding], unit: str) -> str:
    """What cannot be healed, with the first few places, and what to do."""
    said = []
    for kind, what in WRONG.items():
        found = [f for f in findings if f.kind == kind]
        if found:
            listed = "; ".join(finding.told(unit) for finding in found[:MOST_TOLD])
            more = f"; and {len(found) - MOST_TOLD} more" if len(found) > MOST_TOLD else ""
            said.append(f"{what} {listed}{more}")
    return (
        f"{', and '.join(said)}; correct the drawing, leave out a layer (without_layers), or take one region that "
        "has no part in it (region)"
    )


def open_ends(curves: Sequence[Curve], unit: str, shown: str = "") -> str:
    """Where the longest open curve of a drawing without outlines would have to be closed, in its unit.

    ``shown`` is what that is called, where the drawing has none.
    """
    if not curves:
        return "there are no open curves either"
    factor, unit = metres(unit), shown or unit
    longest = max(curves, key=lambda curve: float(curve.lengths.sum()))
    (x0, y0), (x1, y1) = longest.points[[0, -1]] / factor + 0.0
    return (
        f"{len(curves)} open curves were found; the longest ends at ({x0:.6g}, {y0:.6g}) and ({x1:.6g}, {y1:.6g}) "
        f"{unit}, {np.hypot(x1 - x0, y1 - y0):.3g} {unit} apart: join the ends in the drawing"
    )


def named(
    findings: Sequence[Finding], pieces: Sequence[Curve], sources: Sequence[str]
) -> tuple[Finding, ...]:
    """The findings with the entities of the file that lie nearest to their places, up to two."""
    missing = [finding for finding in findings if not finding.entities]
    if not sources or not missing:
        return tuple(findings)
    import shapely

    lines = [shapely.LineString(p.polyline(1e-3 * float(np.max(np.ptp(p.box, axis=0))))) for p in pieces]
    tree = shapely.STRtree(lines)

    def with_entities(finding: Finding) -> Finding:
        if finding.entities:
            return finding
        place = shapely.Point(finding.at)
        _, nearest = tree.query_nearest(place, return_distance=True)
        reach = float(nearest[0]) + max(finding.size, 1e-9 * float(np.hypot(*finding.at)))
        near = tree.query(place, predicate="dwithin", distance=1.5 * reach)
        near = sorted(sorted(map(int, near), key=lambda k: (lines[k].distance(place), k))[:2])
        return replace(finding, entities=tuple(dict.fromkeys(sources[k] for k in near)))

    return tuple(map(with_entities, findings))


def place(point: NDArray[np.float64]) -> tuple[float, float]:
    """A point as a pair of numbers."""
    return float(point[0]), float(point[1])
