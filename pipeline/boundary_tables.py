"""Tables of what holds and loads a body: functions of time, motions, tractions, pressures."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Discriminator, Field, Tag, model_validator

from phantomnode.pipeline.contact_tables import Penalty
from phantomnode.pipeline.values import (
    Name,
    Number,
    Place,
    Switch,
    Table,
    Vector,
    expression_of,
    kind_of_value,
)


class PointTable(Table):
    """A function of time that is linear between points and constant outside them."""

    t: tuple[Number, ...] = Field(min_length=1, description="times, s, increasing")
    value: tuple[Number, ...] = Field(min_length=1, description="values at these times")

    @model_validator(mode="after")
    def _pairs(self) -> PointTable:
        if len(self.t) != len(self.value):
            raise ValueError(
                f"{len(self.t)} times t but {len(self.value)} values; give one value for each time"
            )
        if any(later <= earlier for earlier, later in zip(self.t, self.t[1:], strict=False)):
            raise ValueError(f"t = {list(self.t)} must increase")
        return self


TimeValue = Annotated[
    Annotated[Number, Tag("=number")]
    | Annotated[Annotated[str, expression_of("t")], Tag("=text")]
    | Annotated[PointTable, Tag("=table")],
    Discriminator(kind_of_value),
]


class Directions(Table):
    """Functions of time by direction; a direction that is left out is free."""

    x: TimeValue | None = Field(
        default=None, description="a number, an expression of t, or { t = [...], value = [...] }"
    )
    y: TimeValue | None = Field(
        default=None, description="a number, an expression of t, or { t = [...], value = [...] }"
    )

    @model_validator(mode="after")
    def _some(self) -> Directions:
        if self.x is None and self.y is None:
            raise ValueError("x or y or both must be given")
        return self


class BoxOn(Table):
    """The nodes of a body inside a box."""

    body: Name = Field(description="name of the body")
    box: tuple[Vector, Vector] = Field(description="[[x0, y0], [x1, y1]], m")

    @model_validator(mode="after")
    def _ordered(self) -> BoxOn:
        if not all(low <= high for low, high in zip(*self.box, strict=True)):
            raise ValueError("box must be [[left, bottom], [right, top]]")
        return self


class Boundary(Table):
    """A prescribed motion of a part of a body, or a load on it."""

    on: Annotated[
        Annotated[Place, Tag("=text")] | Annotated[BoxOn, Tag("=table")], Discriminator(kind_of_value)
    ] = Field(
        description='"BODY.PART", as "obstacle.bottom", or { body = "obstacle", box = [[x0, y0], [x1, y1]] }'
    )
    displacement: Directions | None = Field(default=None, description="m")
    velocity: Directions | None = Field(default=None, description="m/s")
    acceleration: Directions | None = Field(default=None, description="m/s^2")
    traction: Directions | None = Field(default=None, description="dead force per reference length, Pa")
    pressure: TimeValue | None = Field(
        default=None,
        description="Pa, positive into the body: a number, an expression of t, or { t = [...], value = [...] }",
    )
    follower: Switch | None = Field(
        default=None, description="pressure on the current length and normal (true unless given), or dead"
    )
    weak: Switch | None = Field(
        default=None,
        description="hold the surface by springs (unless given: where it runs through the inside of cells)",
    )
    penalty: (
        Annotated[
            Annotated[Literal["auto"], Tag("=text")] | Annotated[Penalty, Tag("=table")],
            Discriminator(kind_of_value),
        ]
        | None
    ) = Field(
        default=None,
        description='of the springs: "auto" (20 E/h), { times_auto = 4 }, { times_E = 100 } or { value = 1e12 }, '
        "Pa/m",
    )

    @model_validator(mode="after")
    def _one(self) -> Boundary:
        kind = self.exactly_one("displacement", "velocity", "acceleration", "traction", "pressure")
        load = kind in ("traction", "pressure")
        if load and isinstance(self.on, BoxOn):
            raise ValueError(f'a {kind} acts on a surface, not on the nodes of a box: on = "BODY.PART"')
        for key in ("weak", "penalty"):
            if getattr(self, key) is not None and (load or isinstance(self.on, BoxOn)):
                raise ValueError(
                    f'{key} belongs to a displacement, velocity or acceleration on a "BODY.PART"'
                )
        if self.follower is not None and kind != "pressure":
            raise ValueError(f"follower belongs to a pressure; a {kind} has a direction of its own")
        if self.weak is False and self.penalty is not None:
            raise ValueError("penalty belongs to weak supports; leave out weak = false")
        return self
