"""``phantomnode new``: a small commented case that runs as it is."""

from __future__ import annotations

from pathlib import Path

from phantomnode.pipeline.case import schema_text
from phantomnode.pipeline.errors import CaseError

CASE = """\
#:schema ./case.schema.json
# A disc, drawn in disc.dxf, falls on a block. Run it with:   phantomnode run {folder}
# To start your own: replace disc.dxf by your drawing (DXF, STEP, IGES, BREP, .geo, .msh) and run
#   phantomnode check {folder}
# which draws a preview and says what a run would do, without running.
#
# Units are SI (m, s, kg, Pa), plane strain, forces per metre of thickness.

title = "A disc falls on a block"
time = {{ end = 0.002 }}                      # s; the step is found automatically

[material.rubber]
E = 50e6                                    # Young's modulus, Pa
nu = 0.45                                   # Poisson's ratio, below 0.5
rho = 1100.0                                # density, kg/m^3

[material.plastic]
E = 2e9
nu = 0.35
rho = 1200.0

# A body is an outline, the background grid that it is cut out of (which need not fit it), and a material.
[body.disc]
geometry = {{ file = "disc.dxf", unit = "mm" }}
grid = {{ kind = "cartesian", cell = 0.0025 }}
material = "rubber"
initial_velocity = [0.0, -20.0]             # m/s

[body.block]
geometry = {{ rectangle = {{ low = [-0.08, -0.04], high = [0.08, 0.0] }} }}   # or circle, ring, polygon
grid = {{ kind = "cartesian", cell = 0.005, aligned = true }}
material = "plastic"

# Parts of a body: "outer", "inner" (holes), "bottom", "right", "top", "left", or a layer of the drawing.
[contact.disc_on_block]
slave = "disc.outer"                        # the finer body
master = "block.top"
penalty = "auto"                            # or {{ times_auto = 4 }}, or {{ value = 1e12 }} in Pa/m

[boundary.base]
on = "block.bottom"
displacement = {{ x = 0.0, y = 0.0 }}         # a number, an expression such as "-0.1*t", or a table of points

[output]
fields = {{ count = 40 }}                     # pictures for ParaView: open fields.pvd
history = {{ count = 500 }}                   # rows of history.csv
"""

RADIUS = 25.0
GAP = 0.5
"""Of the disc and between it and the block, mm."""


def write_starter(folder: Path) -> Path:
    """Write a starter case into a new folder.

    Parameters
    ----------
    folder : Path
        Made, with its parents; an empty one is used.

    Returns
    -------
    Path
        The folder, which now holds ``case.toml``, ``disc.dxf`` and, for editors, ``case.schema.json``.

    Raises
    ------
    CaseError
        If the folder holds anything already.
    """
    make_new(folder)
    _write_disc(folder / "disc.dxf")
    (folder / "case.toml").write_text(CASE.format(folder=folder), encoding="utf-8")
    return folder


def make_new(folder: Path) -> None:
    """Make a folder with the schema of cases for editors, and its parents; an empty one is used.

    Raises
    ------
    CaseError
        If it holds anything already.
    """
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise CaseError(f"{folder}: exists already and is left as it is; choose another name")
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "case.schema.json").write_text(schema_text(), encoding="utf-8")


def _write_disc(file: Path) -> None:
    """A circle above the origin, in millimetres."""
    import ezdxf
    from ezdxf.units import MM

    drawing = ezdxf.new("R2010", units=MM)
    drawing.layers.add("disc")
    drawing.modelspace().add_circle((0.0, RADIUS + GAP), RADIUS, dxfattribs={"layer": "disc"})
    drawing.saveas(file)
