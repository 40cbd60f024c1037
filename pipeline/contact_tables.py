"""Tables of the case file for contact pairs."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Discriminator, Field, Tag, model_validator

from phantomnode.pipeline.values import Place, PlaceOrName, Positive, Switch, Table, kind_of_value


class Penalty(Table):
    """A penalty in multiples of the automatic one or of Young's modulus, or as it is."""

    times_auto: Positive | None = Field(default=None, description='penalty in those that "auto" stands for')
    times_E: Positive | None = Field(
        default=None, description="penalty, 1/m, in Young's moduli of the slave's body"
    )
    value: Positive | None = Field(default=None, description="penalty, Pa/m")

    @model_validator(mode="after")
    def _one(self) -> Penalty:
        self.exactly_one("times_auto", "times_E", "value")
        return self

    def stiffness(self, auto: float, young: float) -> float:
        """The penalty, Pa/m, where these are the automatic one, Pa/m, and Young's modulus, Pa."""
        if self.value is not None:
            return self.value
        return self.times_auto * auto if self.times_auto is not None else float(self.times_E or 0.0) * young


class SlavePoints(Table):
    """Where the points of a slave segment stand."""

    rule: Literal["gauss", "newton-cotes"] = Field(
        default="gauss", description='"gauss", or "newton-cotes": equally spaced from end to end'
    )
    count: Annotated[int, Field(strict=True, ge=1, le=32)] = Field(
        default=2, description="points on each slave segment"
    )

    @model_validator(mode="after")
    def _sound(self) -> SlavePoints:
        if self.rule == "newton-cotes" and self.count == 2:
            raise ValueError(
                "two Newton-Cotes points are the ends of the segment alone: one that lies on a vertex of the master "
                "takes either of two normals, a spurious side force; take count = 3, or the Gauss rule"
            )
        if self.rule == "newton-cotes" and self.count in (9, *range(11, 33)):
            raise ValueError(
                f"{self.count} Newton-Cotes points have negative weights, springs that pull; take at most 8, or 10, "
                "or the Gauss rule"
            )
        return self


class Contact(Table):
    """A contact pair: points of the slave do not pass the surface of the master."""

    slave: Place = Field(description='surface whose points are held, "BODY.PART", as "ring.outer"')
    master: PlaceOrName = Field(
        description='surface that holds them, "BODY.PART", "INTERFACE.plus" or the name of a [rigid] obstacle; '
        "the slave's own name for self contact"
    )
    penalty: Annotated[
        Annotated[Literal["auto"], Tag("=text")] | Annotated[Penalty, Tag("=table")],
        Discriminator(kind_of_value),
    ] = Field(
        default="auto",
        description='"auto" (5 E/h), { times_auto = 4 }, { times_E = 100 } or { value = 1e12 }, Pa/m',
    )
    friction: Annotated[float, Field(strict=True, allow_inf_nan=False, ge=0.0)] = Field(
        default=0.0, description="Coulomb's coefficient"
    )
    tangential_penalty: Annotated[
        Annotated[Literal["auto"], Tag("=text")] | Annotated[Penalty, Tag("=table")],
        Discriminator(kind_of_value),
    ] = Field(
        default="auto",
        description='of the stick: "auto" (the normal penalty), { times_auto = 2 }, { times_E = 100 } or '
        "{ value = 1e12 }, Pa/m",
    )
    points: SlavePoints = Field(
        default=SlavePoints(),
        description='{ rule = "gauss" or "newton-cotes", count = n } on each slave segment',
    )
    passes: Annotated[int, Field(strict=True, ge=1, le=2)] = Field(
        default=1, description="2: the master's points against the slave as well, each at half the penalty"
    )
    corners: Switch = Field(
        default=True,
        description="sharp corners of either surface are points too, felt from a depth of 0.01 cells on; without "
        "them a corner can sink in between two points of the slave",
    )
    overlap: Literal["refuse", "offset"] = Field(
        default="refuse", description="what to do where the surfaces overlap at the start"
    )
