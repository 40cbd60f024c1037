"""fields.pvd and contact.pvd: what ParaView shows of a run.

Every frame of ``fields`` is one unstructured grid of all bodies, clipped to their material (clip.py), with
its points where they are at that time; ``displacement`` leads back to where they were. Every frame of
``contact`` holds the slave segments of all pairs as lines.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from phantomnode.pipeline.checkpoint import Tree, frame_of, frame_tree, shown
from phantomnode.pipeline.clip import ClippedBodies, cell_labels
from phantomnode.pipeline.contacts import Pair
from phantomnode.pipeline.corners import nearest_along
from phantomnode.pipeline.observer import Ending, Sampled
from phantomnode.pipeline.prepare import Floats, Ints, Prepared
from phantomnode.pipeline.rigid import Rigid
from phantomnode.pipeline.vtu import (
    VTK_LINE,
    VTK_QUAD,
    VTK_TRIANGLE,
    Encoding,
    Packable,
    Series,
    cells,
    data_array,
    packed_soon,
    vectors,
    vtu_pieces,
)
from phantomnode.solver.contact import reference_length
from phantomnode.solver.stress import States, cut_stress, set_element_states, von_mises

if TYPE_CHECKING:
    from phantomnode.solver.explicit import Frame


STRAIGHT = 1e-4
"""Coordinates are rounded by at most this part of a cell: far less than a pixel of a picture of it."""


def cell_fields(prepared: Prepared, clipped: ClippedBodies, u: Floats) -> States:
    """Stress and strain of every drawn cell from (n, 2) nodal displacements.

    A triangle of a cut element takes the means over its integration points; the von Mises stress is that of
    the mean stress, so that the arrays of a file agree with each other.
    """
    states = States(
        *(
            np.empty((len(clipped.quads) + len(clipped.triangles), *columns))
            for columns in ((4,), (4,), (), ())
        )
    )
    set_cell_fields(prepared, clipped, u, states)
    return states


def set_cell_fields(prepared: Prepared, clipped: ClippedBodies, u: Floats, states: States) -> None:
    """The same, into arrays of float64 or float32 with so many rows."""
    split = len(clipped.quads)
    uncut, cut = (States(*(array[part] for array in states)) for part in (slice(split), slice(split, None)))
    set_element_states(prepared.model.elements, np.asfortranarray(u), uncut)
    means = States(*(clipped.means(values) for values in cut_stress(prepared.model.cut_elements, u)))
    cut.cauchy[:, :4], cut.hencky[:, :4], cut.j[:] = means.cauchy, means.hencky, means.j
    cut.mises[:] = von_mises(means.cauchy)


def tensors(xx: Floats, yy: Floats, zz: Floats, xy: Floats) -> Floats:
    """(m, 6) Symmetric tensors in VTK's order XX YY ZZ XY YZ XZ from their (m,) components."""
    both = np.zeros((len(xx), 6))
    both[:, 0], both[:, 1], both[:, 2], both[:, 3] = xx, yy, zz, xy
    return both


class Highest(NamedTuple):
    """The highest von Mises stress of a body in the frames: Pa, the mean of a cell as it is drawn; when, s; and the
    (2,) middle of that cell on the undeformed body, m.
    """

    stress: float
    time: float
    place: Floats


class Fields(Sampled):
    """Writes fields.pvd and, where there are contact pairs, contact.pvd.

    Parameters
    ----------
    prepared : Prepared
    folder : Path
        The results folder.
    steps : frozenset of int
        The steps to write.
    saved : dict or None
        Go on from what :meth:`saved` gave; the frames written since are removed.

    Raises
    ------
    Damaged
        Where a file is not what it was then.

    Attributes
    ----------
    peak : Frame or None
        The frame with the largest internal energy.
    highest : list of Highest
        Of each body.
    """

    def __init__(
        self, prepared: Prepared, folder: Path, steps: frozenset[int], saved: Tree | None = None
    ) -> None:
        super().__init__(steps)
        names = ("fields", "contact") if prepared.pairs else ("fields",)
        series = [Series(folder / f"{name}.pvd", saved and saved[name]) for name in names]
        self._series = series
        self._bodies = BodiesFile(prepared)
        self._files: list[BodiesFile | ContactFile] = [self._bodies]
        if prepared.pairs:
            self._files.append(ContactFile(prepared))
        self.peak: Frame | None = None
        self.highest = [Highest(0.0, 0.0, np.zeros(2)) for _ in prepared.bodies]
        if saved is not None:
            self.highest = [Highest(float(row[0]), float(row[1]), row[2:]) for row in saved["highest"]]
            self._seen = saved["seen"]
            self.peak = frame_of(saved["peak"]) if saved["peak"] else None

    def take(self, frame: Frame) -> None:
        """Write one frame; remember the one with the largest internal energy for a picture."""
        for file, series in zip(self._files, self._series, strict=True):
            series.add(frame.time, file.vtu(frame))
        pairs = zip(self.highest, self._bodies.highest(frame.time), strict=True)
        self.highest = [max(one, other, key=lambda each: each.stress) for one, other in pairs]
        if self.peak is None or frame.energies.internal > self.peak.energies.internal:
            self.peak = shown(frame)

    def finish(self, ending: Ending) -> None:
        """Write the last frame where it is not there yet; then all of them are on the disk."""
        super().finish(ending)
        self.reach_disk()
        self._files.clear()  # the pictures that follow want the memory
        del self._bodies

    def reach_disk(self) -> None:
        """Wait until the disk holds all frames so far."""
        for series in self._series:
            series.reach_disk()

    def close(self) -> None:
        """End what is underway, also after an error elsewhere."""
        for series in self._series:
            series.close()

    def digests(self) -> dict[Path, str]:
        """SHA-256 of all frames so far."""
        return {file: digest for series in self._series for file, digest in series.digests().items()}

    def saved(self) -> Tree:
        """What the files hold so far, and the frame for the picture."""
        return {
            "seen": self._seen,
            "highest": np.array([[one.stress, one.time, *one.place] for one in self.highest]),
            "peak": {} if self.peak is None else frame_tree(self.peak, resumable=False),
            **{series.path.stem: series.saved() for series in self._series},
        }


def encoding_of(prepared: Prepared) -> Encoding:
    """How the case wants its arrays to be stored."""
    return Encoding(prepared.case.output.fields.precision, prepared.case.output.fields.compression)


def encoding_of_points(prepared: Prepared) -> Encoding:
    """The same; in float64 where bodies lie so far from the origin that float32 would bend their cells."""
    encoding = encoding_of(prepared)
    rounding = 2.0**-24 * float(np.abs(prepared.model.x).max())
    cell = min(body.grid.cell_size for body in prepared.bodies)
    return encoding if rounding <= STRAIGHT * cell else encoding._replace(precision="float64")


class BodiesFile:
    """The files of fields.pvd: what stays the same from one to the next is encoded once.

    Its arrays are kept, too: to have the system map fresh memory for each frame would take as long as to compute it.
    """

    def __init__(self, prepared: Prepared) -> None:
        self._prepared = prepared
        self._encoding = encoding = encoding_of(prepared)
        self._points_as = encoding_of_points(prepared)
        self._clipped = clipped = ClippedBodies.of(prepared)
        blocks = (VTK_QUAD, clipped.quads), (VTK_TRIANGLE, clipped.triangles)
        self._cells = cells(*blocks, encoding=encoding)
        labels = cell_labels(prepared.bodies)._asdict()
        self._labels = {name: data_array(name, values, encoding) for name, values in labels.items()}
        number, kind = len(clipped.quads) + len(clipped.triangles), np.dtype(encoding.precision)
        self._state = States(
            np.zeros((number, 6), kind),
            np.zeros((number, 6), kind),
            np.zeros(number, kind),
            np.zeros(number, kind),
        )
        self._points = np.zeros((clipped.points, 3), np.dtype(self._points_as.precision))
        self._motion = {name: np.zeros((clipped.points, 3), kind) for name in ("displacement", "velocity")}
        ends = len(clipped.quads) + np.cumsum([0, *(len(body.mesh.triangles) for body in prepared.bodies)])
        triangles = [slice(*pair) for pair in zip(ends[:-1], ends[1:], strict=True)]
        self._own = [(body.elements, own) for body, own in zip(prepared.bodies, triangles, strict=True)]

    def vtu(self, frame: Frame) -> list[bytes]:
        """The content of one file, in pieces."""
        clipped, encoding = self._clipped, self._encoding
        for axis in (0, 1):
            self._motion["displacement"][:, axis] = clipped.interpolated(frame.u[:, axis])
            self._motion["velocity"][:, axis] = clipped.interpolated(frame.v[:, axis])
        motion = {name: packed_soon(name, values, encoding) for name, values in self._motion.items()}
        x = self._prepared.model.x  # while the motion is packed
        for axis in (0, 1):
            self._points[:, axis] = clipped.interpolated(x[:, axis] + frame.u[:, axis])
        set_cell_fields(self._prepared, clipped, frame.u, self._state)
        cauchy, hencky, j, mises = self._state
        state = {"stress": cauchy, "von_mises": mises, "hencky_strain": hencky, "J": j}
        return vtu_pieces(
            self._points,
            self._cells,
            motion,
            {**state, **self._labels},
            frame.time,
            encoding,
            self._points_as,
        )

    def highest(self, time: float) -> Iterator[Highest]:
        """The highest von Mises stress of each body in the last file, which was of this time, s."""
        for parts in self._own:
            cells = [
                part.start + int(np.argmax(self._state.mises[part]))
                for part in parts
                if part.stop > part.start
            ]
            cell = max(cells, key=lambda number: self._state.mises[number])
            yield Highest(float(self._state.mises[cell]), time, self._middle(cell))

    def _middle(self, cell: int) -> Floats:
        """(2,) The middle of a cell on the undeformed body, m."""
        quads = self._clipped.quads
        corners = quads[cell] if cell < len(quads) else self._clipped.triangles[cell - len(quads)]
        points = self._points[corners, :2].astype(np.float64) - self._motion["displacement"][corners, :2]
        return np.asarray(points.mean(axis=0))


class ContactLines(NamedTuple):
    """The slave segments of one pair at one time.

    ends (s, 2, 2), m; pressure (s,), Pa, per current length; filtered (s,) the same through the hat filter;
    traction (s, 2) of friction on the slave, Pa; gap (s,), m: negative where the slave
    penetrates, NaN where it is open; normal (s, 2): direction of the force on the slave, zero where open.
    """

    ends: Floats
    pressure: Floats
    filtered: Floats
    traction: Floats
    gap: Floats
    normal: Floats


def contact_lines(prepared: Prepared, number: int, frame: Frame) -> ContactLines:
    """Pressure and gap on the slave segments of a pair (Eq. 25-27).

    The solver weighs a slave point with its reference length, eps g w its force; on the current length the
    same force is the pressure eps g w / (w l / L). Points count by their weights in the means of a segment, and
    corners count with the segment that is nearest to them. Where both surfaces have points at half the penalty,
    either one shows the pressure that both bear together.
    """
    pair: Pair = prepared.pairs[number]
    contact = prepared.model.contact
    shape = (len(pair.segment_nodes), pair.points_per_segment)
    weight = contact.slave_weight[pair.points].reshape(shape)
    share = reference_length(contact)[pair.points].reshape(shape)
    depth = np.maximum(frame.gap[pair.points].reshape(shape), 0.0)
    closed = share * (depth > 0.0)

    x = (prepared.model.x + frame.u)[pair.segment_nodes]
    ends = np.stack([np.einsum("si,sik->sk", n, x) for n in (pair.start_shape, pair.end_shape)], axis=1)
    length = np.hypot(*(ends[:, 1] - ends[:, 0]).T)
    unit = np.where(length > 0.0, 1.0 / np.where(length > 0.0, length, 1.0), 0.0)
    force = pair.share * contact.penalty[pair.passes[0]] * np.sum(weight * depth, axis=1)
    smooth = _smoothed(pair, force, share.sum(axis=1))
    rub = np.zeros((len(length), 2))
    if pair.friction > 0.0:
        rub = pair.share * frame.tangential[pair.points].reshape(*shape, 2).sum(axis=1)

    touching, sunk = closed.sum(axis=1), np.sum(closed * depth, axis=1)
    normal = np.einsum("sg,sgk->sk", closed, frame.normal[pair.points].reshape(*shape, 2))
    for segment, shares in _corner_shares(prepared, pair, frame, ends):
        for values, part in ((force, 0), (smooth, 0), (touching, 1), (sunk, 2)):
            np.add.at(values, segment, shares[:, part])
        np.add.at(normal, segment, shares[:, 3:5])
        np.add.at(rub, segment, shares[:, 5:])
    gap = np.where(touching > 0.0, -sunk / np.where(touching > 0.0, touching, 1.0), np.nan)
    size = np.hypot(*normal.T)
    normal = normal / np.where(size > 0.0, size, 1.0)[:, None]
    return ContactLines(ends, force * unit, smooth * unit, rub * unit[:, None], gap, normal)


def _corner_shares(
    prepared: Prepared, pair: Pair, frame: Frame, ends: Floats
) -> Iterator[tuple[Ints, Floats]]:
    """Closed corners by passes: the slave segment nearest to each, (c,), from the (s, 2, 2) ends, and what it adds.

    The columns (c, 7) are the force, N/m, the weight and its product with the depth, m, that with the normal on the
    slave, and the friction on the slave, N/m.
    """
    contact, x = prepared.model.contact, prepared.model.x + frame.u
    for k in pair.corners:
        g = np.arange(*contact.slave_first[k : k + 2])
        g = g[frame.gap[g] > 0.0]
        place = np.einsum("ci,cia->ca", contact.slave_shape[g], x[contact.slave_nodes[g]])
        sunk = contact.slave_weight[g] * frame.gap[g]
        normal = contact.sign[k] * contact.slave_weight[g, None] * frame.normal[g]
        friction = contact.sign[k] * frame.tangential[g] if pair.friction > 0.0 else np.zeros((len(g), 2))
        columns = (contact.penalty[k] * sunk, contact.slave_weight[g], sunk, normal, friction)
        yield nearest_along(place, ends).segment, np.column_stack(columns)


def _smoothed(pair: Pair, force: Floats, length: Floats) -> Floats:
    """(s,) Forces of the segments, N/m, through the hat filter along their (s,) reference lengths, m."""
    if pair.smoother is None:
        return force.copy()
    rows, columns, weights = pair.smoother
    return length * np.bincount(rows, weights * (force / length)[columns], len(force))


def _obstacle_lines(rigid: Rigid, x: Floats) -> ContactLines:
    """The segments of an obstacle, without contact data, at (n, 2) current positions."""
    count = len(rigid.segments)
    nothing, none = np.zeros(count), np.zeros((count, 2))
    return ContactLines(x[rigid.nodes][rigid.segments], nothing, nothing, none, np.full(count, np.nan), none)


class ContactFile:
    """The files of contact.pvd: the slave segments of all pairs, ``pair`` counting from 0.

    Rigid obstacles follow as lines of the pair -1, so that they are seen.
    """

    def __init__(self, prepared: Prepared) -> None:
        self._prepared = prepared
        counts = [len(pair.segment_nodes) for pair in prepared.pairs]
        counts += [len(rigid.segments) for rigid in prepared.rigids]
        numbers = [*range(len(prepared.pairs)), *(-1 for _ in prepared.rigids)]
        self._encoding = encoding = encoding_of(prepared)
        self._points_as = encoding_of_points(prepared)
        self._cells = cells((VTK_LINE, np.arange(2 * sum(counts)).reshape(-1, 2)), encoding=encoding)
        self._pair = data_array("pair", np.repeat(numbers, counts), encoding)

    def vtu(self, frame: Frame) -> list[bytes]:
        """The content of one file, in pieces."""
        prepared = self._prepared
        lines = [contact_lines(prepared, number, frame) for number in range(len(prepared.pairs))]
        lines += [_obstacle_lines(rigid, prepared.model.x + frame.u) for rigid in prepared.rigids]
        ends, pressure, filtered, traction, gap, normal = map(np.concatenate, zip(*lines, strict=True))
        cell_data: Mapping[str, Packable] = {
            "pressure": pressure,
            "pressure_filtered": filtered,
            "traction": vectors(traction),
            "gap": gap,
            "normal": vectors(normal),
            "pair": self._pair,
        }
        points, encoding = vectors(ends.reshape(-1, 2)), self._encoding
        return vtu_pieces(points, self._cells, {}, cell_data, frame.time, encoding, self._points_as)
