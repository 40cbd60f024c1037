from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from cad import read_here

from phantomnode.geometry import svg
from phantomnode.geometry.curves import Geometry, arc_centre
from phantomnode.geometry.errors import GeometryError, OutlineError
from phantomnode.geometry.readers import read_geometry

EXACT = 1e-12
"""Some roundings of 15 digits, those of transforms among them."""

HEAD = '<svg xmlns="http://www.w3.org/2000/svg" xmlns:xlink="http://www.w3.org/1999/xlink" '
PAGE = 'width="100mm" height="50mm" viewBox="0 0 200 100">'


def read(folder: Path, text: str, unit: str | None = None, name: str = "d.svg") -> Geometry:
    (folder / name).write_text(text)
    return read_here(folder / name, unit)


def test_circles_stay_circles_in_the_size_of_the_page_with_y_upwards(tmp_path: Path) -> None:
    text = f'{HEAD}{PAGE}<circle id="rim" cx="60" cy="40" r="30"/><circle id="bore" cx="60" cy="40" r="10"/></svg>'
    for unit, size in ((None, 0.5e-3), ("mm", 0.5e-3), ("cm", 1e-2)):
        (region,) = read(tmp_path, text, unit).regions
        assert region.area == pytest.approx(800 * np.pi * size**2, rel=EXACT, abs=0.0)
        for loop, name, radius in ((region.outer, "rim", 30), (region.holes[0], "bore", 10)):
            centres = arc_centre(loop.points[:-1], loop.points[1:], loop.bulges)
            assert np.allclose(centres, [60 * size, 60 * size], rtol=EXACT, atol=0.0) and loop.name == name
            assert np.hypot(*(loop.points[:-1] - centres).T) == pytest.approx(
                radius * size, rel=EXACT, abs=0.0
            )


def test_transforms_and_units_of_groups_are_applied(tmp_path: Path) -> None:
    slot = '<path d="M 10 10 h 20 a 5 5 0 0 1 0 10 h -20 z"/>'
    text = f'{HEAD}width="10in" viewBox="0 0 100 100"><g transform="rotate(30) scale(2)">{slot}</g></svg>'
    (region,) = read(tmp_path, text).regions
    assert region.area == pytest.approx((800 + 50 * np.pi) * 0.00254**2, rel=EXACT, abs=0.0)
    assert np.count_nonzero(region.outer.bulges) == 1


def test_a_stretched_circle_and_a_bezier_keep_the_chord_error(tmp_path: Path) -> None:
    text = f'{HEAD}><circle transform="scale(2,1)" cx="60" cy="40" r="30"/><path d="M 0 100 Q 50 0 100 100 z"/></svg>'
    ellipse, parabola = read(tmp_path, text, "m").regions
    assert ellipse.area == pytest.approx(1800 * np.pi, rel=1e-5) and parabola.area == pytest.approx(
        10000 / 3, rel=1e-5
    )
    places = ellipse.outer.points - [120, -40]
    assert np.hypot(places[:, 0] / 60, places[:, 1] / 30) == pytest.approx(1.0, rel=EXACT)


def test_what_is_used_again_hidden_or_no_shape(tmp_path: Path) -> None:
    square = '<rect id="q" width="10" height="10"/>'
    text = f"{HEAD}><defs>{square}</defs><clipPath id='c'><rect width='5' height='5'/></clipPath>"
    text += (
        '<use xlink:href="#q" x="20"/><use xlink:href="#q" x="40"/><text>hi</text><image href="/etc/passwd"/>'
    )
    text += (
        '<rect width="3" height="3" display="none"/><rect width="3" height="3" visibility="hidden"/></svg>'
    )
    geometry = read(tmp_path, text, "mm")
    assert [region.outer.name for region in geometry.regions] == ["q", "q"]
    assert geometry.notes == ("left out: 1 hidden rect, 1 image, 1 text",)


@pytest.mark.parametrize(
    ("body", "unit", "message"),
    [
        (f"{PAGE}<g", None, "SVG drawing is damaged .unclosed token"),
        (f"{PAGE}</svg>", None, "holds no curves .it holds nothing at all"),
        ("><rect width='1' height='1'/></svg>", None, "does not say in which unit"),
        ("width='100%'><rect width='1' height='1'/></svg>", None, "does not say in which unit"),
        (
            f"{PAGE}<g id='a'><rect width='1' height='1'/><use xlink:href='#a'/></g></svg>",
            None,
            "uses itself",
        ),
        (
            "width='9mm' height='9mm' viewBox='0 0 9 5'><rect width='1' height='1'/></svg>",
            None,
            "scale it evenly",
        ),
    ],
)
def test_bad_drawings_are_refused(tmp_path: Path, body: str, unit: str | None, message: str) -> None:
    with pytest.raises(GeometryError, match=message):
        read(tmp_path, HEAD + body, unit)


def test_outlines_that_cross_are_told(tmp_path: Path) -> None:
    (tmp_path / "d.svg").write_text(f"{HEAD}{PAGE}<path d='M 0 0 L 9 9 L 9 0 L 0 9 z'/></svg>")
    with pytest.raises(OutlineError, match="crosses or touches itself"):
        read_geometry(tmp_path / "d.svg")


def test_xml_entities_neither_grow_nor_read_files(tmp_path: Path) -> None:
    grow = "".join(f'<!ENTITY a{k} "' + 10 * f"&a{k - 1};" + '">' for k in range(1, 12))
    for entities, used in (
        (f'<!ENTITY a0 "lol">{grow}', "a11"),
        ('<!ENTITY x SYSTEM "file:///etc/passwd">', "x"),
    ):
        with pytest.raises(GeometryError, match="damaged"):
            read(
                tmp_path,
                f'<?xml version="1.0"?><!DOCTYPE s [{entities}]>{HEAD}{PAGE}<text>&{used};</text></svg>',
            )


def test_too_many_segments_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(svg, "MOST_SEGMENTS", 10)
    with pytest.raises(GeometryError, match="more than 10 segments"):
        read(tmp_path, HEAD + PAGE + 3 * '<rect width="1" height="1"/>' + "</svg>")


def test_wkt_polygons_are_regions_and_lines_are_curves(tmp_path: Path) -> None:
    parts = "POLYGON ((0 0, 4 0, 4 3, 0 3, 0 0), (1 1, 2 1, 2 2, 1 2, 1 1)), LINESTRING Z (0 0 5, 1 1 5), POINT (0 0)"
    geometry = read(tmp_path, f"SRID=0; GEOMETRYCOLLECTION ({parts})", "cm", "d.wkt")
    (region,) = geometry.regions
    assert region.area == pytest.approx(11e-4, rel=EXACT, abs=0.0) and len(region.holes) == 1
    assert geometry.curves[0].points.tolist() == [[0.0, 0.0], [0.01, 0.01]]
    assert geometry.notes == ("left out: 1 points and empty shapes",)


def test_geojson_features_have_names(tmp_path: Path) -> None:
    ring = "[[0,0],[2,0],[2,1],[0,1],[0,0]]"
    polygon = f'{{"type": "Polygon", "coordinates": [{ring}]}}'
    named = f'{{"type": "Feature", "properties": {{"name": "plate"}}, "geometry": {polygon}}}'
    empty = '{"type": "Feature", "properties": null, "geometry": null}'
    text = f'{{"type": "FeatureCollection", "features": [{named}, {empty}]}}'
    (tmp_path / "d.json").write_text(text)
    (region,) = read_geometry(tmp_path / "d.json", "m").regions  # through the child
    assert (region.name, region.outer.name, region.area) == ("plate", "plate", 2.0)
    assert read(tmp_path, polygon, "m", "e.json").regions[0].name == ""


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("POLYGON ((0 0, 4 0", "WKT is damaged"),
        ("CIRCULARSTRING (0 0, 1 1, 2 0)", "Nonlinear geometry types are not"),
        ("POLYGON ((0 0, 1 1, 1 0, 0 1, 0 0))", "Polygon is not valid: Self-intersection"),
        ("LINESTRING Z (0 0 0, 1 1 1)", "this is 3D"),
        ("POINT (0 0)", "no curve of any length"),
        ('{"type": "Other"}', "GeoJSON is damaged"),
        ('{"type": "Feature"}', "GeoJSON is damaged .KeyError: 'geometry'"),
        ('{"type": "Polygon", "coordinates": [[[0, 0], [1, "x"]]]}', "GeoJSON is damaged"),
    ],
)
def test_bad_text_is_refused(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(GeometryError, match=message):
        read(tmp_path, text, "m", "d.txt")


def test_svg_and_text_have_no_layers_faces_or_sections(tmp_path: Path) -> None:
    (tmp_path / "d.wkt").write_text("POLYGON ((0 0, 1 0, 0 1, 0 0))")
    for choice in ({"face": 1}, {"section": ("z", 0.0)}):
        with pytest.raises(GeometryError, match="WKT file has no faces or solids"):
            read_here(tmp_path / "d.wkt", "m", **choice)
    with pytest.raises(GeometryError, match="WKT file; only DXF drawings have layers"):
        read_here(tmp_path / "d.wkt", "m", layers=["a"])
