"""The thinnest wall of a part, by closed forms."""

from __future__ import annotations

import numpy as np
import pytest

from phantomnode.geometry.curves import Region
from phantomnode.geometry.shapes import circle, polygon, rectangle, ring
from phantomnode.geometry.walls import thinnest_wall


def test_of_a_ring_it_is_the_difference_of_its_radii():
    assert thinnest_wall([ring((0.3, 0.1), 0.5, 0.42)]) == pytest.approx(0.08, rel=1e-3)  # arcs as chords


def test_of_a_rectangle_it_is_the_shorter_side_and_of_a_disc_the_diameter():
    assert thinnest_wall([rectangle((0.0, 0.0), (3.0, 0.7))]) == pytest.approx(0.7, rel=1e-12)
    assert thinnest_wall([circle((0.0, 0.0), 2.0)]) == pytest.approx(4.0, rel=1e-3)


def test_of_several_regions_it_is_the_thinnest():
    plates = [rectangle((0.0, k), (1.0, k + t)) for k, t in enumerate((0.3, 0.02, 0.1))]
    assert thinnest_wall(plates) == pytest.approx(0.02, rel=1e-12)


def test_corners_are_no_walls():
    """The faces of a triangle meet at 60 degrees: no two are parallel."""
    assert thinnest_wall([polygon([(0.0, 0.0), (1.0, 0.0), (0.5, 0.866)])]) == np.inf


def test_a_short_fin_is_a_detail_and_a_long_one_a_wall():
    def block_with_fin(length):
        return polygon(
            [(0, 0), (1, 0), (1, 1), (0.51, 1), (0.51, 1 + length), (0.5, 1 + length), (0.5, 1), (0, 1)]
        )

    assert thinnest_wall([block_with_fin(0.02)]) == pytest.approx(1.0, rel=1e-12)
    assert thinnest_wall([block_with_fin(0.4)]) == pytest.approx(0.01, rel=1e-9)


def test_a_gap_is_no_wall():
    """Between the arms of a fork there is nothing: the ray goes into the material."""
    fork = polygon([(0, 0), (1, 0), (1, 2), (0.55, 2), (0.55, 0.5), (0.45, 0.5), (0.45, 2), (0, 2)])
    assert thinnest_wall([fork]) == pytest.approx(0.45, rel=1e-9)


def test_it_is_that_of_brute_force():
    """Against all segments for every place, of a star with a hole."""
    from phantomnode.geometry.walls import _normals, _places

    angle = np.linspace(0.0, 2.0 * np.pi, 41)[:-1]
    radius = 1.0 + 0.35 * np.cos(5 * angle)
    star = polygon(radius[:, None] * np.column_stack([np.cos(angle), np.sin(angle)]))
    region = Region(star.outer, (circle((0.0, 0.0), 0.3).outer,))
    chains = [loop.polyline(1e-4 * float(np.max(np.ptp(region.box, axis=0)))) for loop in region.loops]
    segments = np.concatenate([np.stack([c[:-1], c[1:]], axis=1) for c in chains])
    places, inward = _places(segments)
    normals, thick = _normals(segments), []
    for place, direction in zip(places, inward, strict=True):
        best = (np.inf, False)
        for (a, b), normal in zip(segments, normals, strict=True):
            facing = direction @ normal
            if facing >= 0.0:
                continue
            t = (a - place) @ normal / facing
            at = place + t * direction
            if t > 0.0 and 0.0 <= (at - a) @ (b - a) <= (b - a) @ (b - a) and t < best[0]:
                best = (t, facing <= -np.cos(np.radians(30.0)))
        thick.append(best[0] if best[1] else np.inf)
    assert thinnest_wall([region]) == pytest.approx(np.sort(thick)[int(0.02 * len(thick))], rel=1e-9)
