"""What no single table of a case can know: names that refer to each other, files, functions of time."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import numpy as np

from phantomnode.pipeline.boundary_tables import BoxOn, TimeValue
from phantomnode.pipeline.contact_tables import Contact
from phantomnode.pipeline.expressions import ExpressionError, time_function
from phantomnode.pipeline.figure_checks import case_faults
from phantomnode.pipeline.messages import listed, shown, suggestion
from phantomnode.pipeline.schema import Case, Hourglass
from phantomnode.pipeline.shapes import Drawing, FileGrid, MappedGrid
from phantomnode.pipeline.values import Table

PROBES = 1001
"""Times at which a function of time is tried before anything is prepared."""


def cross_check(case: Case) -> list[str]:
    """Everything that is wrong between the tables of a case; each message starts with its key."""
    faults = [*_names(case), *_references(case), *_surfaces(case), *_files(case), *_motions(case)]
    return [*faults, *_methods(case), *_profiles(case), *case_faults(case)]


def _names(case: Case) -> Iterator[str]:
    """Bodies, interfaces and obstacles share the names of surfaces; obstacles and boundaries those of reactions."""
    for name in case.interface.keys() & case.body.keys():
        yield f"interface.{name}: a body has this name too; rename one of the two"
    for table in ("body", "interface", "boundary"):
        for name in case.rigid.keys() & getattr(case, table).keys():
            yield f"rigid.{name}: there is a {table} of this name too; rename one of the two"


def _methods(case: Case) -> Iterator[str]:
    """What classic X-FEM, there for the comparison of waves, does not do."""
    if case.method == "xfem" and case.contact:
        yield (
            'method = "xfem": classic X-FEM runs without contact; take method = "phantom", or leave out '
            f"[contact.{next(iter(case.contact))}]"
        )
    others = {
        'integration.uncut = "full"': case.integration.uncut == "full",
        "integration.alpha": case.integration.alpha > 1.0,
        "damping.mass": case.damping.mass > 0.0,
        "damping.bulk_viscosity": any(case.damping.bulk_viscosity.model_dump().values()),
        "hourglass.viscosity": isinstance(case.hourglass, Hourglass) and case.hourglass.viscosity > 0.0,
        "mass_scaling": case.mass_scaling is not None,
    }
    if case.method == "xfem" and any(others.values()):
        given = listed(key for key, used in others.items() if used)
        yield f'method = "xfem": classic X-FEM runs without {given}; take method = "phantom", or leave it out'


def _profiles(case: Case) -> Iterator[str]:
    """Times of profiles lie within the run."""
    for name, profile in case.output.profile.items():
        if profile.times[-1] > case.time.end:
            yield (
                f"output.profile.{name}.times: {profile.times[-1]:g} s lies beyond the end of the run, "
                f"{case.time.end:g} s"
            )


def _references(case: Case) -> Iterator[str]:
    """Names of materials, grids and bodies."""
    for name, body in case.body.items():
        if body.material not in case.material:
            yield _unknown(f"body.{name}.material", body.material, "material", case.material)
        if isinstance(body.grid, str) and body.grid not in case.grid:
            yield _unknown(f"body.{name}.grid", body.grid, "grid", case.grid)
    for name, interface in case.interface.items():
        if interface.body not in case.body:
            yield _unknown(f"interface.{name}.body", interface.body, "body", case.body)
    for name, boundary in case.boundary.items():
        if isinstance(boundary.on, BoxOn) and boundary.on.body not in case.body:
            yield _unknown(f"boundary.{name}.on.body", boundary.on.body, "body", case.body)


def _surfaces(case: Case) -> Iterator[str]:
    """Names such as "ring.outer" (whether a body has the part is known once its geometry is read)."""
    for name, contact in case.contact.items():
        yield from _surface(case, f"contact.{name}.slave", contact.slave)
        if contact.master not in case.rigid:
            yield from _surface(case, f"contact.{name}.master", contact.master)
        yield from _contact(case, f"contact.{name}", contact)
    for name, boundary in case.boundary.items():
        if isinstance(boundary.on, str):
            yield from _surface(case, f"boundary.{name}.on", boundary.on)


def _contact(case: Case, key: str, contact: Contact) -> Iterator[str]:
    """What the two surfaces of a pair allow."""
    own, rigid = contact.slave == contact.master, contact.master in case.rigid
    if own and contact.slave.partition(".")[0] not in case.body:
        yield (
            f"{key}: slave and master are both {shown(contact.slave)}, a side of an interface, which cannot touch "
            "itself; name its two sides"
        )
    if contact.passes == 2 and rigid:
        yield f"{key}.passes = 2: the obstacle {contact.master} has no points of its own; take passes = 1"
    if contact.passes == 2 and own:
        yield f"{key}.passes = 2: self contact tests every point of the curve as it is; take passes = 1"


def _surface(case: Case, key: str, place: str) -> Iterator[str]:
    """A name of a surface: its owner exists, and a side of an interface is plus or minus."""
    owner, _, part = place.partition(".")
    owners = [*case.body, *case.interface]
    if owner in case.rigid:
        yield f"{key} = {shown(place)}: {owner} is a rigid obstacle, which is a master as a whole: {shown(owner)}"
    elif owner not in owners:
        masters = [*owners, *case.rigid] if key.endswith(".master") else owners
        yield _unknown(
            key, place, "body, interface or obstacle" if case.rigid else "body or interface", masters, owner
        )
    elif not part:
        yield f"{key} = {shown(place)}: name a part of it, as in {shown(owner + '.outer')}"
    elif owner in case.interface and owner not in case.body and part not in ("plus", "minus"):
        yield f"{key} = {shown(place)}: the sides of an interface are {owner}.plus and {owner}.minus"


def _unknown(key: str, value: str, what: str, known: Iterable[str], name: str = "") -> str:
    """The message for a name that nothing has."""
    names, name = list(known), name or value
    hint = suggestion(name, names)
    return f"{key} = {shown(value)}: there is no {what} {name!r}{hint}; there are: {listed(names)}"


def _files(case: Case) -> Iterator[str]:
    """Files that are not there."""
    for key, table in tables_with_files(case):
        file = str(table.file)
        if case.path(file).is_file():
            continue
        folder = case.path(file).parent
        near = sorted(entry.name for entry in folder.iterdir()) if folder.is_dir() else []
        hint = suggestion(case.path(file).name, near)
        yield f"{key}.file = {shown(file)}: there is no such file in {folder}{hint}"


def tables_with_files(case: Case) -> Iterator[tuple[str, Drawing | FileGrid]]:
    """Every table that names a file, with its key."""
    for key, table in _tables(case):
        if isinstance(table, Drawing | FileGrid) and table.file is not None:
            yield key, table


def _tables(case: Case) -> Iterator[tuple[str, Table]]:
    """Every geometry and grid with its key."""
    for name, body in case.body.items():
        yield f"body.{name}.geometry", body.geometry
        if not isinstance(body.grid, str):
            yield from _grid_tables(f"body.{name}.grid", body.grid)
    for name, interface in case.interface.items():
        yield f"interface.{name}.geometry", interface.geometry
    for name, rigid in case.rigid.items():
        yield f"rigid.{name}.geometry", rigid.geometry
    for name, grid in case.grid.items():
        yield from _grid_tables(f"grid.{name}", grid)


def _grid_tables(key: str, grid: Table) -> Iterator[tuple[str, Table]]:
    """The tables of a grid that may name a file."""
    if isinstance(grid, FileGrid):
        yield key, grid
    elif isinstance(grid, MappedGrid):
        for side in ("bottom", "right", "top", "left"):
            yield f"{key}.{side}", getattr(grid, side)


def _motions(case: Case) -> Iterator[str]:
    """Functions of time: finite over the run, and a displacement starts from where the body is."""
    for name, boundary in case.boundary.items():
        for kind in ("displacement", "velocity", "acceleration", "traction"):
            for direction in ("x", "y"):
                value = getattr(getattr(boundary, kind), direction, None)
                yield from _motion(case, value, f"boundary.{name}.{kind}.{direction}", kind)
        yield from _motion(case, boundary.pressure, f"boundary.{name}.pressure", "pressure")
    for axis, value in enumerate(case.gravity):
        yield from _motion(case, value, f"gravity.{axis}", "gravity")
    for name, rigid in case.rigid.items():
        for kind in ("displacement", "velocity"):
            for direction in ("x", "y"):
                value = getattr(getattr(rigid, kind), direction, None)
                yield from _motion(case, value, f"rigid.{name}.{kind}.{direction}", kind)
        if rigid.geometry.function is not None and rigid.geometry.x is None:
            yield f"rigid.{name}.geometry: a function needs its range here, x = [first, last] in m"
        if all(contact.master != name for contact in case.contact.values()):
            yield f"rigid.{name}: no contact has it as its master; add one, or leave the obstacle out"


def _motion(case: Case, value: TimeValue | None, key: str, kind: str) -> Iterator[str]:
    """One function of time."""
    if value is None:
        return
    try:
        values = time_function(value)(np.linspace(0.0, case.time.end, PROBES))
    except ExpressionError as error:
        yield f"{key}: {error}"
        return
    # A jump at t = 0 would be an infinite velocity; 1e-12 of the largest value is rounding in the expression.
    if kind == "displacement" and abs(values[0]) > 1e-12 * np.max(np.abs(values)):
        yield (
            f"{key}: the displacement at t = 0 is {values[0]:g} m, but the body starts undeformed; "
            f"let it start from 0 (a ramp), or move the geometry"
        )
