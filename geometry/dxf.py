"""Regions and curves of a DXF drawing."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from fnmatch import fnmatchcase
from typing import Any

import numpy as np

from phantomnode.geometry.curves import Contents, Curve, Geometry, diagonal
from phantomnode.geometry.dxf_entities import AREAS, Item, Sheet, SolidError
from phantomnode.geometry.dxf_load import load, quiet
from phantomnode.geometry.errors import GeometryError
from phantomnode.geometry.flatten import CHORD_ERROR, trace
from phantomnode.geometry.loops import assemble, join
from phantomnode.geometry.units import INSUNITS, chosen, metres

MOST_ENTITIES = 100_000
"""Entities of a drawing with its blocks expanded; nested blocks and arrays of inserts grow without bound."""

DEEPEST = 30
"""Blocks within blocks."""

PLANE = 1e-6
"""Part of the drawing's diagonal by which z may differ between curves of one plane."""

SOLIDS = {"3DSOLID", "BODY", "SURFACE", "EXTRUDEDSURFACE", "REVOLVEDSURFACE", "LOFTEDSURFACE", "SWEPTSURFACE",
          "PLANESURFACE", "NURBSURFACE", "MESH", "3DFACE", "POLYFACE", "POLYMESH"}  # fmt: skip

SOLID = (
    "this is a 3D drawing, and a plane problem needs a planar outline: "
    "draw the section in the xy plane (constant z)"
)


@dataclass(frozen=True)
class _Shown:
    """One entity with its blocks expanded, its layer, what it is in words, and whether it counts."""

    entity: Any
    layer: str
    source: str


@dataclass
class _Layers:
    """Which layers count: those that are shown and not left out, or exactly those that are asked for."""

    states: dict[str, str]
    names: dict[str, str]
    contents: dict[str, Counter[str]] = field(default_factory=dict)

    @classmethod
    def of(cls, document: Any, only: Sequence[str], without: Sequence[str]) -> _Layers:
        """The layers of a document; patterns such as "cut*" name any number of them."""
        states, names = {}, {"0": "0"}
        for layer in document.layers:
            name = str(layer.dxf.name)
            names[name.lower()] = name
            states[name.lower()] = "frozen" if layer.is_frozen() else "off" if layer.is_off() else ""
        for entity in document.entitydb.values():  # a layer need not be in the table
            if entity.dxf.is_supported("layer") and entity.dxf.hasattr("layer"):
                names.setdefault(str(entity.dxf.layer).lower(), str(entity.dxf.layer))
        chosen_ones = _matching("layers", only, names)
        dropped = _matching("without_layers", without, names)
        for key in names:
            if only:
                states[key] = "" if key in chosen_ones else "not asked for"
            if key in dropped:
                states[key] = "left out"
        return cls(states, names)

    def take(self, found: _Shown) -> bool:
        """Whether an entity counts; keeps the score of what is where."""
        key = found.layer.lower()
        self.contents.setdefault(key, Counter())[found.entity.dxftype()] += 1
        return not self.states.get(key)

    def report(self) -> tuple[Contents, ...]:
        """What is on each layer, in the order of the first entity."""
        return tuple(
            Contents(self.names.get(key, key), tuple(sorted(counts.items())), self.states.get(key, ""))
            for key, counts in self.contents.items()
        )

    def notes(self) -> list[str]:
        """What the layers that do not count hold."""
        return [
            f"layer '{layer.name}' is {layer.state}: {_listed(Counter(dict(layer.kinds)))} on it do not count"
            for layer in self.report()
            if layer.state in ("off", "frozen")
        ]


def _matching(key: str, patterns: Sequence[str], names: dict[str, str]) -> set[str]:
    """The layers, in small letters, that any of the patterns means."""
    found: set[str] = set()
    for pattern in patterns:
        hits = {name for name in names if fnmatchcase(name, pattern.lower()) or name == pattern.lower()}
        if not hits:
            listed = ", ".join(f"'{name}'" for name in sorted(names.values()))
            raise GeometryError(f"{key}: no layer is called '{pattern}'; there are {listed}")
        found |= hits
    return found


def read_dxf(
    content: bytes,
    unit: str | None,
    time_limit: float,
    layers: Sequence[str] = (),
    without_layers: Sequence[str] = (),
) -> Geometry:
    """Regions and curves of a DXF drawing, in metres.

    LINE, ARC, CIRCLE, ELLIPSE, LWPOLYLINE, POLYLINE, SPLINE, HELIX and MLINE of the model space, also in blocks
    (INSERT); of the first paper space with curves where it has none; and the boundaries of filled areas (HATCH,
    MPOLYGON, SOLID, TRACE) where there are no curves at all. Layers become the names of pieces; layer "0" gives
    none. Other kinds are noted.

    Parameters
    ----------
    content : bytes
        ASCII or binary.
    unit : str or None
        Goes before that of the file.
    time_limit : float, s
        Of processor time.
    layers, without_layers : sequence of str
        Names or patterns ("cut*"). Without ``layers`` all that are shown count.

    Raises
    ------
    GeometryError
        For a damaged or 3D drawing, one without curves, and one without a unit where none is given.
    """
    import ezdxf

    deadline = time.process_time() + time_limit
    with quiet():
        document, notes = load(content)
        name, unit_notes = chosen(unit, INSUNITS.get(_header(document, "$INSUNITS", 0)), _unit_hint(document))
        chosen_layers = _Layers.of(document, layers, without_layers)
        try:
            sheet, more = _sheet(document, chosen_layers, deadline)
        except GeometryError:
            raise
        except (ezdxf.DXFError, ValueError, ArithmeticError, LookupError, TypeError, AttributeError) as error:
            raise GeometryError(f"the DXF file is damaged ({error}); export it again") from error
    notes += chosen_layers.notes() + more
    if sheet.left_out:
        notes.append(f"left out: {_listed(sheet.left_out)}")
    factor = metres(name)
    pieces, sources = _joined_loops([piece.scaled(factor) for piece in _flattened(sheet.items)], sheet.items)
    geometry = assemble(pieces, sources)
    return replace(
        geometry, notes=(*unit_notes, *notes, *geometry.notes), unit=name, contents=chosen_layers.report()
    )


def _header(document: Any, name: str, default: int) -> int:
    """An integer variable of the header; damaged ones count as the default."""
    try:
        return int(document.header.get(name, default))
    except (TypeError, ValueError):
        return default


def _unit_hint(document: Any) -> str:
    """What the file says about units where it has none."""
    system = _header(document, "$MEASUREMENT", -1)
    return {
        0: "the drawing was made with English units, so perhaps in",
        1: "the drawing is metric, so perhaps mm",
    }.get(system, "")


def _listed(counts: Counter[str]) -> str:
    return ", ".join(f"{count} {kind}" for kind, count in sorted(counts.items()))


def _sheet(document: Any, layers: _Layers, deadline: float) -> tuple[Sheet, list[str]]:
    """The curves of the model space, else of the first paper space that has some, else boundaries of areas."""
    model = list(_expanded(document.modelspace(), layers, deadline))
    sheet = _filled(model, areas=False)
    if sheet.items:
        _check_plane(sheet.items)
        return sheet, []
    spaces = [("model space", model)] + [
        (f"paper space '{layout.name}'", list(_expanded(layout, layers, deadline)))
        for layout in document.layouts
        if layout.name != "Model"
    ]
    for areas in (False, True):
        for label, found in spaces:
            filled = _filled(found, areas=areas)
            if filled.items:
                notes = [f"the model space holds no curves: {label} is taken"] if found is not model else []
                if areas:
                    notes.append("there are no curves: the boundaries of filled areas are taken")
                _check_plane(filled.items)
                return filled, notes
    raise GeometryError(_nothing(sheet, layers))


def _nothing(sheet: Sheet, layers: _Layers) -> str:
    """Why there is no curve."""
    if SOLIDS & set(sheet.left_out):
        return f"{SOLID}; it holds {_listed(sheet.left_out)}"
    hidden = "; ".join(layers.notes())
    return (
        f"the drawing holds no curves (it holds {_listed(sheet.left_out) or 'nothing at all'}"
        f"{'; ' + hidden if hidden else ''}); explode or draw the outline with lines, arcs, circles, ellipses, "
        "polylines or splines on a layer that is shown"
    )


def _filled(found: list[_Shown], *, areas: bool) -> Sheet:
    """The curves among the entities, or the boundaries of the areas."""
    sheet = Sheet()
    for shown in found:
        if (shown.entity.dxftype() in AREAS) == areas:
            try:
                sheet.add(shown.entity, "" if shown.layer == "0" else shown.layer, shown.source)
            except GeometryError as error:
                if isinstance(error.__cause__, SolidError):
                    raise GeometryError(f"{SOLID}; {shown.source}: {error.__cause__}") from error
                raise
        else:
            sheet.left_out[shown.entity.dxftype()] += 1
    return sheet


def _expanded(space: Any, layers: _Layers, deadline: float) -> Iterator[_Shown]:
    """Every entity of a space on layers that count, blocks and multilines replaced by what they hold."""
    stack: list[Iterator[_Shown]] = [_direct(space)]
    count = 0
    while stack:
        found = next(stack[-1], None)
        if found is None:
            stack.pop()
            continue
        count += 1
        if count > MOST_ENTITIES or time.process_time() > deadline:
            raise GeometryError(
                f"the drawing holds more than {min(count, MOST_ENTITIES)} entities with its blocks expanded, "
                "too many to read in the time: explode or purge its blocks, keep the outline only"
            )
        kind = found.entity.dxftype()
        if kind == "INSERT":
            # What is in a block may lie on other layers; a frozen layer hides it all the same.
            if layers.states.get(found.layer.lower()) == "frozen":
                layers.take(found)
            elif len(stack) > DEEPEST:
                raise GeometryError(
                    f"blocks are nested more than {DEEPEST} deep at '{found.entity.dxf.name}'; explode them"
                )
            else:
                stack.append(_inside(found))
        elif layers.take(found):
            if kind == "MLINE":
                stack.append(_virtual(found, f"of {found.source}"))
            else:
                yield found


def _direct(space: Any) -> Iterator[_Shown]:
    """The entities of a space itself, without those that are hidden one by one."""
    for entity in space:
        if not entity.dxf.get("invisible", 0):
            layer = _layer(entity)
            yield _Shown(entity, layer, f"{entity.dxftype()} {entity.dxf.handle} on layer '{layer}'")


def _inside(insert: _Shown) -> Iterator[_Shown]:
    """What an INSERT shows, one array place after the other; layer "0" in a block means the insert's layer."""
    entity = insert.entity
    if entity.block() is None:
        raise GeometryError(f"{insert.source} shows the block '{entity.dxf.name}', which is missing")
    if entity.mcount > MOST_ENTITIES:
        raise GeometryError(
            f"{insert.source} repeats a block {entity.mcount} times, more than {MOST_ENTITIES} entities; explode it"
        )
    if entity.dxf.zscale == 0.0:
        entity = entity.copy()
        entity.dxf.zscale = 1.0  # plane blocks are inserted so, and have no height to scale
    for place in entity.multi_insert() if entity.mcount > 1 else [entity]:
        yield from _virtual(
            _Shown(place, insert.layer, insert.source), f"in block '{entity.dxf.name}' of {insert.source}"
        )


def _virtual(parent: _Shown, where: str) -> Iterator[_Shown]:
    """What a block reference or multiline is made of."""
    for entity in parent.entity.virtual_entities():
        own = _layer(entity)
        layer = parent.layer if own == "0" else own
        origin = entity.source_of_copy
        handle = f" {origin.dxf.handle}" if origin is not None and origin.dxf.handle else ""
        if not entity.dxf.get("invisible", 0):
            yield _Shown(entity, layer, f"{entity.dxftype()}{handle} on layer '{layer}' {where}")


def _layer(entity: Any) -> str:
    """The layer of an entity; damaged files hold entities that cannot have one."""
    return str(entity.dxf.layer) if entity.dxf.is_supported("layer") else "0"


def _check_plane(items: list[Item]) -> None:
    """Refuse curves that do not lie in one plane of constant z, naming one."""
    size = diagonal([Curve(item.points, item.bulges) for item in items])
    plane = float(np.median([float(item.heights[0]) for item in items]))
    for item in items:
        off = item.heights[np.argmax(np.abs(item.heights - plane))]
        if abs(off - plane) > PLANE * size:
            raise GeometryError(
                f"{SOLID}; most curves lie at z = {plane:g}, but {item.source} reaches z = {off:g}: flatten the "
                "drawing, or leave out that layer (without_layers)"
            )


def _joined_loops(pieces: list[Curve], items: list[Item]) -> tuple[list[Curve], list[str]]:
    """The pieces and their sources, those of one closed boundary joined before all others."""
    loops: dict[int, list[int]] = {}
    for k, item in enumerate(items):
        loops.setdefault(item.loop, []).append(k)
    alone = loops.pop(-1, [])
    joined, sources = [pieces[k] for k in alone], [items[k].source for k in alone]
    for members in loops.values():
        chains = join([pieces[k] for k in members])
        joined += [*chains.closed, *chains.open]
        sources += [items[members[0]].source] * len((*chains.closed, *chains.open))
    return joined, sources


def _flattened(items: list[Item]) -> list[Curve]:
    """Each item as lines and arcs."""
    size = diagonal([Curve(item.points, item.bulges) for item in items])
    pieces = []
    for item in items:
        points, bulges = item.points, item.bulges
        if item.free is not None:
            try:
                points, bulges = trace(*item.free, CHORD_ERROR * size)
            except GeometryError as error:
                raise GeometryError(f"{item.source} cannot be read ({error}); redraw or delete it") from error
        pieces.append(Curve(points, bulges, (item.layer,) * len(bulges)))
    return pieces
