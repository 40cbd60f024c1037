"""Geometry as text: WKT and GeoJSON (OGC simple features)."""

from __future__ import annotations

import json
from collections.abc import Iterator
from typing import Any

import numpy as np

from phantomnode.geometry.curves import Curve, Geometry, Region
from phantomnode.geometry.errors import GeometryError
from phantomnode.geometry.loops import join
from phantomnode.geometry.units import chosen, metres


def read_features(text: str, kind: str, unit: str | None) -> Geometry:
    """Regions and curves of "wkt" or "geojson", in metres: polygons are regions, lines are curves.

    The property "name" of a GeoJSON feature, else its id, is the name of its regions and curves.

    Raises
    ------
    GeometryError
        For text that is damaged, polygons that are not valid, and where no unit is given.
    """
    import shapely

    name, notes = chosen(unit, None)
    factor = metres(name)
    regions, curves, points = [], [], 0
    for shape, label in _wkt(text) if kind == "wkt" else _geojson(text):
        if not shape.is_valid:
            raise GeometryError(f"a {shape.geom_type} is not valid: {shapely.is_valid_reason(shape)}")
        for part in shapely.get_parts(shapely.force_2d(_flat(shape))):
            if part.geom_type == "Polygon" and not part.is_empty:
                loops = [_curve(ring, factor, label) for ring in (part.exterior, *part.interiors)]
                regions.append(Region(loops[0], tuple(loops[1:]), label))
            elif part.geom_type in ("LineString", "LinearRing") and part.length > 0.0:
                curves.append(_curve(part, factor, label))
            else:
                points += 1
    chains = join(curves)
    left = (f"left out: {points} points and empty shapes",) if points else ()
    found = chains.closed + chains.open
    return Geometry(tuple(regions), found, (*notes, *left, *chains.notes), name)


def _wkt(text: str) -> Iterator[tuple[Any, str]]:
    """The shape of a WKT text."""
    import shapely

    try:
        yield from ((part, "") for part in _simple(shapely.from_wkt(text.strip().rpartition(";")[2])))
    except (shapely.errors.GEOSException, ValueError, NotImplementedError) as error:
        raise GeometryError(f"the WKT is damaged ({error})") from error


def _geojson(text: str) -> Iterator[tuple[Any, str]]:
    """The shapes of a GeoJSON text with their names."""
    import shapely

    try:
        data = json.loads(text)
        for item in data["features"] if data["type"] == "FeatureCollection" else [data]:
            feature = item["type"] == "Feature"
            label = (item.get("properties") or {}).get("name") or item.get("id") or "" if feature else ""
            if feature and item["geometry"] is None:
                continue
            shape = shapely.from_geojson(json.dumps(item["geometry"] if feature else item))
            yield from ((part, str(label)) for part in _simple(shape))
    except (
        shapely.errors.GEOSException,
        ValueError,
        TypeError,
        KeyError,
        AttributeError,
        RecursionError,
    ) as error:
        raise GeometryError(f"the GeoJSON is damaged ({type(error).__name__}: {error})") from error


def _simple(shape: Any) -> Iterator[Any]:
    """The shapes in a collection of collections."""
    if shape is not None and shape.geom_type == "GeometryCollection":
        for part in shape.geoms:
            yield from _simple(part)
    elif shape is not None:
        yield shape


def _flat(shape: Any) -> Any:
    """The shape, after making sure that it lies at one height and is finite."""
    import shapely

    places = shapely.get_coordinates(shape, include_z=bool(shape.has_z))
    if not np.all(np.isfinite(places)):
        raise GeometryError("a coordinate is not finite")
    if shape.has_z and np.ptp(places[:, 2]) > 0.0:
        raise GeometryError("this is 3D, and a plane problem needs a planar outline (constant z)")
    return shape


def _curve(line: Any, factor: float, name: str) -> Curve:
    """A chain of straight lines without repeated points."""
    import shapely

    points = shapely.get_coordinates(line) * factor
    points = points[np.concatenate([[True], np.any(np.diff(points, axis=0) != 0.0, axis=1)])]
    return Curve(points, np.zeros(len(points) - 1), (name,) * (len(points) - 1), name)
