"""Tables of the case file for geometry and grids."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Discriminator, Field, Tag, model_validator

from phantomnode.geometry.limits import LONGEST, TIME_LIMIT
from phantomnode.pipeline.values import (
    Count,
    Counts,
    Name,
    Number,
    Positive,
    Switch,
    Table,
    Unit,
    Vector,
    expression_of,
    kind_of_grid,
    kind_of_value,
)

Seconds = Annotated[float, Field(strict=True, gt=0.0, le=LONGEST)]


class Placement(Table):
    """Where a geometry goes: scaled, then rotated about the origin, then moved."""

    scale: Positive = Field(default=1.0, description="factor on all lengths, about the origin")
    rotate: Number = Field(default=0.0, description="degrees, counter-clockwise, about the origin")
    move: Vector = Field(default=(0.0, 0.0), description="[dx, dy], m")


class Rectangle(Table):
    """A rectangle along the axes."""

    low: Vector = Field(description="lower left corner [x, y], m")
    high: Vector = Field(description="upper right corner [x, y], m")

    @model_validator(mode="after")
    def _has_area(self) -> Rectangle:
        if not (self.low[0] < self.high[0] and self.low[1] < self.high[1]):
            raise ValueError(f"low = {list(self.low)} must lie below and left of high = {list(self.high)}")
        return self


class Circle(Table):
    """A circle."""

    centre: Vector = Field(description="[x, y], m")
    radius: Positive = Field(description="m")


class Ring(Table):
    """The region between two concentric circles."""

    centre: Vector = Field(description="[x, y], m")
    outer: Positive = Field(description="outer radius, m")
    inner: Positive = Field(description="inner radius, m")

    @model_validator(mode="after")
    def _has_wall(self) -> Ring:
        if self.inner >= self.outer:
            raise ValueError(f"inner = {self.inner:g} must be smaller than outer = {self.outer:g}")
        return self


class Polygon(Table):
    """A region inside straight lines; the last point is joined to the first."""

    points: tuple[Vector, ...] = Field(min_length=3, description="three or more points [x, y], m")


class Polyline(Table):
    """An open chain of straight lines; closed where the last point equals the first."""

    points: tuple[Vector, ...] = Field(min_length=2, description="two or more points [x, y], m")


class Section(Table):
    """Where solids are cut: the plane in which one coordinate has a value."""

    axis: Literal["x", "y", "z"] = Field(
        description='"z" gives an outline in (x, y), "y" in (x, z), "x" in (y, z)'
    )
    at: Number = Field(description="the value of that coordinate, m")


class Drawing(Placement):
    """A geometry that may come from a file."""

    file: str | None = Field(default=None, min_length=1, description="CAD file, relative to the case file")
    unit: Unit | None = Field(default=None, description='length unit of the file, such as "mm"')
    layers: tuple[str, ...] = Field(
        default=(), description='layers of a DXF file that alone count, by name or pattern ("cut*")'
    )
    without_layers: tuple[str, ...] = Field(
        default=(), description="layers of a DXF file that do not count, by name or pattern"
    )
    trust_scripts: Switch = Field(
        default=False, description="run commands in a .geo script (it can do anything)"
    )
    time_limit: Seconds = Field(
        default=TIME_LIMIT, description="give up reading the file after so many seconds"
    )
    face: (
        Annotated[
            Annotated[Count, Tag("=number")] | Annotated[str, Field(min_length=1), Tag("=text")],
            Discriminator(kind_of_value),
        ]
        | None
    ) = Field(default=None, description="name or number of the flat face of a 3D part to take")
    section: Section | None = Field(
        default=None, description='where to cut the solids of a 3D part: { axis = "z", at = 0.005 }'
    )

    @model_validator(mode="after")
    def _file_options(self) -> Drawing:
        if self.face is not None and self.section is not None:
            raise ValueError("face and section are both given; give the one to take")
        for key in ("unit", "region", "layers", "without_layers", "trust_scripts", "face", "section"):
            if self.file is None and getattr(self, key, None):
                raise ValueError(f"{key} belongs to a file, but no file is given; shapes are in metres")
        if self.file is None and self.time_limit != TIME_LIMIT:
            raise ValueError("time_limit belongs to a file, but no file is given")
        return self


class BodyGeometry(Drawing):
    """The outline of a body: a file or one shape."""

    region: (
        Annotated[
            Annotated[Count, Tag("=number")] | Annotated[str, Field(min_length=1), Tag("=text")],
            Discriminator(kind_of_value),
        ]
        | None
    ) = Field(
        default=None, description="name or number (as `inspect` counts) of the region of the file to take"
    )
    rectangle: Rectangle | None = Field(default=None, description="{ low = [x, y], high = [x, y] }")
    circle: Circle | None = Field(default=None, description="{ centre = [x, y], radius = r }")
    ring: Ring | None = Field(default=None, description="{ centre = [x, y], outer = R, inner = r }")
    polygon: Polygon | None = Field(default=None, description="{ points = [[x, y], ...] }")

    @model_validator(mode="after")
    def _one_source(self) -> BodyGeometry:
        self.exactly_one("file", "rectangle", "circle", "ring", "polygon")
        return self


class CurveGeometry(Drawing):
    """A curve: a file, one shape, or a function y(x)."""

    polyline: Polyline | None = Field(default=None, description="open: { points = [[x, y], ...] }")
    rectangle: Rectangle | None = Field(default=None, description="closed: { low = [x, y], high = [x, y] }")
    circle: Circle | None = Field(default=None, description="closed: { centre = [x, y], radius = r }")
    polygon: Polygon | None = Field(default=None, description="closed: { points = [[x, y], ...] }")
    function: Annotated[str, expression_of("x")] | None = Field(
        default=None, description="y as an expression of x, m"
    )
    x: Vector | None = Field(
        default=None, description="[first, last] x of a function, m; the body's width unless given"
    )

    @model_validator(mode="after")
    def _one_source(self) -> CurveGeometry:
        source = self.exactly_one("file", "polyline", "rectangle", "circle", "polygon", "function")
        if self.x is not None and source != "function":
            raise ValueError(f"x belongs to a function, not to a {source}")
        if self.x is not None and self.x[0] >= self.x[1]:
            raise ValueError(f"x = {list(self.x)} must increase")
        return self


class CartesianGrid(Table):
    """Rectangular cells along the axes."""

    kind: Literal["cartesian"]
    cell: (
        Annotated[
            Annotated[Positive, Tag("=number")] | Annotated[tuple[Positive, Positive], Tag("=list")],
            Discriminator(kind_of_value),
        ]
        | None
    ) = Field(default=None, description="edge of a cell, m: h or [hx, hy]")
    counts: Counts | None = Field(default=None, description="cells in x and y: [nx, ny]")
    box: tuple[Vector, Vector] | None = Field(
        default=None, description="[[x0, y0], [x1, y1]], m; the body's bounding box unless given"
    )
    aligned: Switch = Field(default=False, description="whether grid lines go through the sides of the box")

    @model_validator(mode="after")
    def _sized(self) -> CartesianGrid:
        self.exactly_one("cell", "counts")
        if self.box is not None and not all(low < high for low, high in zip(*self.box, strict=True)):
            raise ValueError("box must be [[left, bottom], [right, top]] with left < right and bottom < top")
        return self

    @property
    def spacing(self) -> tuple[float, float] | None:
        """(hx, hy) in metres where ``cell`` is given, None where ``counts`` is."""
        if self.cell is None:
            return None
        return self.cell if isinstance(self.cell, tuple) else (self.cell, self.cell)


class PolarGrid(Table):
    """Cells between circles and rays about a centre."""

    kind: Literal["polar"]
    centre: Vector = Field(description="[x, y], m")
    radii: tuple[Positive, Positive] = Field(description="[inner, outer] radius, m")
    angles: Vector = Field(default=(0.0, 360.0), description="[first, last] angle, degrees from the x axis")
    counts: Counts = Field(description="cells [in radius, around]")

    @model_validator(mode="after")
    def _spans(self) -> PolarGrid:
        if self.radii[0] >= self.radii[1]:
            raise ValueError(f"radii = {list(self.radii)} must be [inner, outer] with inner < outer")
        if not 0.0 < self.angles[1] - self.angles[0] <= 360.0:
            raise ValueError(f"angles = {list(self.angles)} must span more than 0 and at most 360 degrees")
        if self.counts[1] < 3:
            raise ValueError(f"counts = {list(self.counts)} needs at least 3 cells around")
        return self


class MappedGrid(Table):
    """Cells between four curves that meet at their ends."""

    kind: Literal["mapped"]
    bottom: CurveGeometry = Field(description="curve from the lower left to the lower right corner")
    right: CurveGeometry = Field(description="curve from the lower right to the upper right corner")
    top: CurveGeometry = Field(description="curve from the upper left to the upper right corner")
    left: CurveGeometry = Field(description="curve from the lower left to the upper left corner")
    counts: Counts = Field(description="cells [along bottom, along left]")

    @model_validator(mode="after")
    def _curves_end(self) -> MappedGrid:
        for side in ("bottom", "right", "top", "left"):
            curve: CurveGeometry = getattr(self, side)
            for closed in ("rectangle", "circle", "polygon"):
                if getattr(curve, closed) is not None:
                    raise ValueError(f"{side} is a {closed}, which has no ends; four open curves are needed")
            if curve.function is not None and curve.x is None:
                raise ValueError(f"{side} is a function and needs its range: x = [first, last]")
        return self


class FileGrid(Table):
    """An unstructured mesh of quadrilaterals from a gmsh file."""

    file: str = Field(
        min_length=1, description="gmsh file (.msh) of quadrilaterals, relative to the case file"
    )
    unit: Unit | None = Field(default=None, description='length unit of the file, such as "mm"')
    time_limit: Seconds = Field(
        default=TIME_LIMIT, description="give up reading the file after so many seconds"
    )


Grid = Annotated[
    Annotated[CartesianGrid, Tag("=cartesian")]
    | Annotated[PolarGrid, Tag("=polar")]
    | Annotated[MappedGrid, Tag("=mapped")]
    | Annotated[FileGrid, Tag("=file")],
    Discriminator(kind_of_grid),
]
GridOrName = Annotated[
    Annotated[Name, Tag("=text")]
    | Annotated[CartesianGrid, Tag("=cartesian")]
    | Annotated[PolarGrid, Tag("=polar")]
    | Annotated[MappedGrid, Tag("=mapped")]
    | Annotated[FileGrid, Tag("=file")],
    Discriminator(kind_of_grid),
]
