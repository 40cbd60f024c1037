"""What a case file holds: one model a table, with its units, defaults and limits.

Everything is SI: metres, seconds, kilograms, pascals; angles in degrees.
"""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, BeforeValidator, Discriminator, Field, Tag, model_validator

from phantomnode.pipeline.boundary_tables import Boundary, Directions, TimeValue
from phantomnode.pipeline.contact_tables import Contact
from phantomnode.pipeline.durations import EVERY, parse_every
from phantomnode.pipeline.figure_tables import Figure
from phantomnode.pipeline.shapes import (
    BodyGeometry,
    CartesianGrid,
    CurveGeometry,
    FileGrid,
    Grid,
    GridOrName,
    MappedGrid,
    PolarGrid,
)
from phantomnode.pipeline.values import (
    Count,
    Name,
    Number,
    Positive,
    Switch,
    Table,
    Vector,
    kind_of_value,
)


class Time(Table):
    """How long to run and with which step."""

    end: Positive = Field(description="end of the run, s")
    step: Annotated[
        Annotated[Literal["auto"], Tag("=text")] | Annotated[Positive, Tag("=number")],
        Discriminator(kind_of_value),
    ] = Field(default="auto", description='"auto" (the stable step times safety) or a step in s')
    safety: Annotated[float, Field(strict=True, gt=0.0, le=1.0)] = Field(
        default=0.85, description="part of the stable step that the automatic step takes"
    )
    force: Switch = Field(default=False, description="take the given step even if it is unstable")


class Material(Table):
    """An isotropic Hencky material in plane strain."""

    E: Positive = Field(description="Young's modulus, Pa")
    nu: Number = Field(description="Poisson's ratio")
    rho: Positive = Field(description="density, kg/m^3")

    @model_validator(mode="after")
    def _compressible(self) -> Material:
        if self.nu == 0.5:
            raise ValueError(
                "nu = 0.5 is incompressible: the wave speed is infinite and no step stable; take 0.49"
            )
        if not -1.0 < self.nu < 0.5:
            raise ValueError(f"nu = {self.nu:g} must lie between -1 and 0.5 (0.3 for steel)")
        return self


class Body(Table):
    """A body: an outline, the grid it is cut out of, a material."""

    geometry: BodyGeometry = Field(description="a file or one shape, and where it goes")
    grid: GridOrName = Field(description="a grid, or the name of one in [grid]")
    material: Name = Field(description="name of a material in [material]")
    initial_velocity: Vector = Field(default=(0.0, 0.0), description="[vx, vy], m/s")


class Interface(Table):
    """A curve that splits a body: an interface or a crack. Its sides are NAME.plus (left) and NAME.minus."""

    body: Name = Field(description="name of the body it splits")
    geometry: CurveGeometry = Field(description="a file, one shape or a function, and where it goes")


class Xfem(Table):
    """Classic X-FEM with Heaviside enrichment, for comparison (paper, section 2.2)."""

    mass: Literal["consistent", "lumped", "block-diagonal"] = Field(
        default="consistent",
        description="mass matrix: consistent, lumped (row sums within the standard and within the enriched "
        "block) or block-diagonal (2 x 2 a node, Menouillard et al. 2008)",
    )
    enrichment: Literal["heaviside", "shifted"] = Field(
        default="heaviside",
        description="H = -1 or +1 (Eq. 8), or shifted so that it vanishes at the nodes; matters to lumped mass",
    )


class Rigid(Table):
    """A rigid obstacle: a curve without a mesh, at rest or moved."""

    geometry: CurveGeometry = Field(description="a file, one shape or a function, and where it goes")
    side: Literal["left", "right"] = Field(
        default="left",
        description="where the obstacle is: left of the curve as it runs, inside a closed one; or the other side",
    )
    displacement: Directions | None = Field(default=None, description="m; at rest unless given")
    velocity: Directions | None = Field(default=None, description="m/s")

    @model_validator(mode="after")
    def _one_motion(self) -> Rigid:
        if self.displacement is not None and self.velocity is not None:
            raise ValueError(
                "displacement and velocity are both given; give one, or none for an obstacle at rest"
            )
        return self


class Relocation(Table):
    """Grid nodes near an outline are moved onto it."""

    distance: Annotated[float, Field(strict=True, ge=0.0, lt=0.5)] = Field(
        default=0.1, description="in cell sizes; 0 switches it off"
    )


Fraction = Annotated[float, Field(strict=True, ge=0.0, le=1.0)]
Part = Annotated[float, Field(strict=True, allow_inf_nan=False, ge=0.0)]


class Hourglass(Table):
    """What holds the hourglass modes of uncut elements with one point."""

    stiffness: Fraction = Field(
        default=0.0, description="Flanagan-Belytschko stiffness parameter, 0.05 to 0.15"
    )
    viscosity: Fraction = Field(
        default=0.0, description="Flanagan-Belytschko viscosity, part of critical damping, 0.03 to 0.1"
    )

    @model_validator(mode="after")
    def _some(self) -> Hourglass:
        if not self.model_fields_set:
            raise ValueError("stiffness or viscosity must be given (hourglass = 0.1 is stiffness = 0.1)")
        return self


def _plain_number(value: object) -> object:
    """The value; true, which Python takes for 1, as text, which no number is."""
    return str(value).lower() if isinstance(value, bool) else value


class Integration(Table):
    """How elements are integrated."""

    uncut: Literal["one-point", "full"] = Field(
        default="one-point",
        description='"one-point" with hourglass control, or "full": 2 x 2 Gauss points without it',
    )
    cut: Annotated[Literal[3, 1], BeforeValidator(_plain_number)] = Field(
        default=3, description="points on each triangle of a fragment; 1 takes a fan about the centroid"
    )
    alpha: Annotated[float, Field(strict=True, allow_inf_nan=False, ge=1.0)] = Field(
        default=1.0, description="factor on internal force and mass of small cut elements (Eq. 30); 1 is off"
    )
    alpha_below: Fraction = Field(default=0.1, description="fraction of its cell below which one is small")


class BulkViscosity(Table):
    """A pressure against fast compression, rho L r (linear c_d + quadratic^2 L r) at the rate r = -dJ/dt."""

    linear: Part = Field(default=0.0, description="spreads fronts over some cells; 0.06 is usual")
    quadratic: Part = Field(default=0.0, description="for shocks; 1.2 is usual")


class Damping(Table):
    """What takes energy out; all of it is in the balance."""

    mass: Part = Field(default=0.0, description="alpha_M of the force -alpha_M m v, 1/s")
    bulk_viscosity: BulkViscosity = Field(
        default=BulkViscosity(), description="{ linear = 0.06, quadratic = 1.2 }; off unless given"
    )


class MassScaling(Table):
    """Mass is added to the elements that would not bear the wanted step."""

    step: Positive = Field(description="the step that is to be stable, s, the safety included")


class Guard(Table):
    """When to stop a run that goes wrong."""

    energy_error: Positive = Field(
        default=0.05, description="largest energy error, relative to the largest energy seen"
    )


class Frames(Table):
    """How often to write."""

    count: Count = Field(description="number of times written after the start, at equal intervals")


class FieldFrames(Frames):
    """How often to write fields for ParaView, and how."""

    precision: Literal["float32", "float64"] = Field(
        default="float32",
        description="of the stored numbers; points get float64 where float32 would move them by 1e-4 of a cell",
    )
    compression: Literal["zlib", "lz4", "none"] = Field(
        default="zlib",
        description="what packs them: zlib (smallest, read by all), lz4 (faster; needs phantomnode[lz4]) or none",
    )

    @model_validator(mode="after")
    def _packer(self) -> FieldFrames:
        if self.compression == "lz4" and find_spec("lz4") is None:
            raise ValueError(
                'compression = "lz4" needs the package lz4, which is not here: pip install "phantomnode[lz4]", '
                'or take "zlib"'
            )
        return self


class Profile(Table):
    """A quantity along a straight line, at some times."""

    line: tuple[Vector, Vector] = Field(description="[[x0, y0], [x1, y1]] on the undeformed bodies, m")
    quantity: Literal["stress_xx", "stress_yy", "stress_zz", "stress_xy", "von_mises", "J"] = Field(
        description="what to take from the cells along the line"
    )
    times: tuple[Positive, ...] = Field(
        min_length=1, description="s, increasing; the nearest steps are taken"
    )

    @model_validator(mode="after")
    def _in_order(self) -> Profile:
        if self.line[0] == self.line[1]:
            raise ValueError("line has no length; give two points")
        if any(later <= earlier for earlier, later in zip(self.times, self.times[1:], strict=False)):
            raise ValueError(f"times = {list(self.times)} must increase")
        return self


def _interval(text: str) -> str:
    """The text itself, where it is an interval."""
    parse_every(text)
    return text


class Checkpoint(Table):
    """How often a run writes all that it needs to go on, so that it loses no more when it is killed."""

    every: Annotated[str, AfterValidator(_interval)] = Field(
        default="10 min", description=f"{EVERY}; the two last are kept"
    )


class Output(Table):
    """What to write."""

    fields: FieldFrames = Field(
        default=FieldFrames(count=60),
        description='fields for ParaView: { count = 60, precision = "float32", compression = "zlib" }',
    )
    history: Frames = Field(default=Frames(count=2000), description="rows of history.csv")
    profile: dict[Name, Profile] = Field(default={}, description="quantities along lines, at some times")
    checkpoint: Checkpoint = Field(default=Checkpoint(), description='{ every = "10 min" }')


class Case(Table):
    """Everything the user said, validated, in SI."""

    title: str = Field(default="", description="one line that says what this is")
    name: Name = Field(
        default="case", description="name of the results folder; that of the case unless given"
    )
    folder: Path = Field(
        default=Path("."), description="where files are taken from; the case file's folder unless given"
    )
    time: Time = Field(description="{ end = seconds }")
    gravity: tuple[TimeValue, TimeValue] = Field(
        default=(0.0, 0.0), description="[gx, gy], m/s^2, numbers or functions of time"
    )
    hourglass: Annotated[
        Annotated[Fraction, Tag("=number")] | Annotated[Hourglass, Tag("=table")],
        Discriminator(kind_of_value),
    ] = Field(
        default=0.1,
        description="stiffness of uncut elements, 0.05 to 0.15, or { stiffness = 0.1 } or { viscosity = 0.05 }",
    )
    integration: Integration = Field(default=Integration(), description='{ uncut = "one-point", cut = 3 }')
    damping: Damping = Field(default=Damping(), description="{ mass = 1/s }; bulk_viscosity")
    mass_scaling: MassScaling | None = Field(default=None, description="{ step = seconds }")
    material: dict[Name, Material] = Field(min_length=1, description="one table for each material")
    grid: dict[Name, Grid] = Field(default={}, description="grids that several bodies share")
    body: dict[Name, Body] = Field(min_length=1, description="one table for each body")
    interface: dict[Name, Interface] = Field(default={}, description="curves that split bodies")
    contact: dict[Name, Contact] = Field(default={}, description="contact pairs")
    rigid: dict[Name, Rigid] = Field(default={}, description="rigid obstacles given by curves")
    boundary: dict[Name, Boundary] = Field(default={}, description="prescribed motions and loads")
    method: Literal["phantom", "xfem"] = Field(
        default="phantom", description="phantom nodes, or classic X-FEM for comparison (without contact)"
    )
    xfem: Xfem = Field(default=Xfem(), description='{ mass = "consistent", enrichment = "heaviside" }')
    relocation: Relocation = Field(default=Relocation(), description="{ distance = 0.1 }")
    guard: Guard = Field(default=Guard(), description="{ energy_error = 0.05 }")
    output: Output = Field(
        default=Output(), description="{ fields = { count = 60 }, history = { count = 2000 } }"
    )
    figure: dict[Name, Figure] = Field(default={}, description="pictures, with their data as CSV")
    variant: dict[Name, dict[str, Any]] = Field(
        default={}, description="cases to run and to compare with this one: only the keys that differ"
    )

    def path(self, file: str) -> Path:
        """Where a file named in the case lies."""
        return self.folder / Path(file).expanduser()

    def grid_of(self, body: str) -> CartesianGrid | PolarGrid | MappedGrid | FileGrid:
        """The grid of a body, its own or the shared one."""
        grid = self.body[body].grid
        return self.grid[grid] if isinstance(grid, str) else grid
