"""``phantomnode paraview``: a script that shows a run in ParaView, and ParaView itself where there is one."""

from __future__ import annotations

import os
import shutil
import subprocess
from pathlib import Path
from typing import NamedTuple

import numpy as np

from phantomnode.pipeline.errors import CaseError
from phantomnode.pipeline.files import write_atomically
from phantomnode.pipeline.results import Results

SCRIPT = "in_paraview.py"
LOOKED_AT = 9
"""Frames, evenly spread over the run, from which the range of the stress is taken, with that of most energy."""

HIGHEST = 0.998
"""The part of the cells whose stress the colours span: one point under contact does not darken the rest."""


class View(NamedTuple):
    """What the script shows: von Mises stress and contact pressure up to, Pa; time at first, s; box, m."""

    stress: float
    pressure: float
    time: float
    low: tuple[float, float]
    high: tuple[float, float]


def write_script(results: Results) -> Path:
    """Write in_paraview.py into the folder of a run: von Mises stress on the deformed bodies, with contact pressure.

    ParaView 5.9 or later runs it, with a window or without one; it also serves after the folder was moved.

    Returns
    -------
    Path
        The script.

    Raises
    ------
    CaseError
        Where the folder holds no frame that can be read.
    """
    view, path = view_of(results), results.path / SCRIPT
    constants = {
        "FOLDER": str(results.path.resolve()),
        "TITLE": results.title,
        "CONTACT": bool(results.pairs) and (results.path / "contact.pvd").is_file(),
        "STRESS": view.stress,
        "PRESSURE": view.pressure,
        "TIME": view.time,
        "LOW": view.low,
        "HIGH": view.high,
    }
    head = "".join(f"{name} = {value!r}\n" for name, value in constants.items())
    write_atomically(path, STATE.replace("CONSTANTS\n", head))
    return path


def view_of(results: Results) -> View:
    """Ranges and box over the run, and the time of the largest stress; of the bodies from some of the frames."""
    times = results.times
    results.nearest("start")  # refuses a run without frames
    spread = np.linspace(0, len(times) - 1, min(LOOKED_AT, len(times))).astype(np.int64)
    some = np.unique([*spread, results.nearest("peak")])
    stress, pressure, boxes = [], [0.0], []
    for time in times[some]:
        frame = results.frame(float(time))
        stress.append(float(np.quantile(frame.cell("von_mises"), HIGHEST)))
        boxes.append((frame.points.min(axis=0), frame.points.max(axis=0)))
    for time in times if results.pairs else ():  # small files; the largest pressure may be that of one frame
        contact = results.contact(float(time))
        boxes.append((contact.ends.min(axis=(0, 1)), contact.ends.max(axis=(0, 1))))
        pressure.append(float(np.max(contact.cell_data["pressure"], initial=0.0)))
    low, high = np.min([a for a, _ in boxes], axis=0), np.max([b for _, b in boxes], axis=0)
    return View(
        max(stress) or 1.0, max(pressure) or 1.0, float(times[some[int(np.argmax(stress))]]),
        (float(low[0]), float(low[1])), (float(high[0]), float(high[1])),
    )  # fmt: skip


def open_paraview(script: Path) -> None:
    """Start ParaView with a script, and leave it to the user.

    Raises
    ------
    CaseError
        Where there is no ParaView, or no screen for it.
    """
    program = shutil.which("paraview")
    if program is None:
        raise CaseError(
            "no program paraview is found on the PATH; install it (paraview.org, or apt-get install paraview), "
            f"or open it yourself: paraview --script={script}"
        )
    if os.name == "posix" and os.uname().sysname == "Linux" and not _screen():
        raise CaseError(
            "there is no screen for ParaView here (neither DISPLAY nor WAYLAND_DISPLAY is set); a picture needs "
            f"none: pvbatch {script} picture.png"
        )
    subprocess.Popen([program, f"--script={script}"], start_new_session=True)


def _screen() -> bool:
    return bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))


STATE = '''\
"""A run of phantomnode in ParaView: von Mises stress on the deformed bodies, and contact pressure.

    paraview --script=in_paraview.py                     (or Tools > Python Shell > Run Script)
    pvbatch in_paraview.py picture.png [TIME]            without a window; TIME in s

Bodies and the sides of interfaces are parted by black lines. To colour by something else, choose it in the window:
"body" and "side" number the bodies and their connected parts. SCALE exaggerates the motion.
"""
import os
import sys

from paraview.simple import *

CONSTANTS
SCALE = 1.0
BESIDE = os.path.dirname(os.path.abspath(__file__)) if "__file__" in globals() else FOLDER
FOLDER = BESIDE if os.path.isfile(os.path.join(BESIDE, "fields.pvd")) else FOLDER
SIZE = ((HIGH[0] - LOW[0]) ** 2 + (HIGH[1] - LOW[1]) ** 2) ** 0.5
WIDTH, HEIGHT = 1600, 1000


def main():
    view = GetActiveViewOrCreate("RenderView")
    if not hasattr(view, "CameraParallelProjection"):
        view = CreateRenderView()
    for name, value in (("UseColorPaletteForBackground", 0), ("BackgroundColorMode", "Single Color")):
        if hasattr(view, name):
            setattr(view, name, value)
    view.Background = [1.0, 1.0, 1.0]
    view.OrientationAxesVisibility = 0
    if len(sys.argv) > 1:  # no window that has a size
        view.ViewSize = [WIDTH, HEIGHT]
    bodies(view)
    if CONTACT:
        contact(view)
    labels(view)
    animation = GetAnimationScene()
    animation.UpdateAnimationUsingDataTimeSteps()
    wanted = float(sys.argv[2]) if len(sys.argv) > 2 else TIME
    animation.AnimationTime = min(GetTimeKeeper().TimestepValues, key=lambda time: abs(time - wanted))
    camera(view)
    Render(view)
    if len(sys.argv) > 1:
        SaveScreenshot(sys.argv[1], view, ImageResolution=[WIDTH, HEIGHT])


def series(name):
    return PVDReader(registrationName=name, FileName=os.path.join(FOLDER, name + ".pvd"))


def bodies(view):
    """The bodies where they are, in the colours of the stress, and their outlines."""
    fields = series("fields")
    # The points stand where they are; SCALE - 1 of the displacement comes on top of it.
    moved = WarpByVector(registrationName="bodies", Input=fields)
    moved.Vectors = ["POINTS", "displacement"]
    moved.ScaleFactor = SCALE - 1.0
    shown = Show(moved, view)
    shown.Representation = "Surface"
    coloured(
        shown, view, ("CELLS", "von_mises"), "Turbo", STRESS, "von Mises stress, Pa", "Upper Right Corner"
    )
    surface = ExtractSurface(Input=moved)
    edges = FeatureEdges(registrationName="outlines", Input=surface)
    edges.BoundaryEdges, edges.FeatureEdges, edges.NonManifoldEdges = 1, 0, 0
    if hasattr(edges, "ColoringVTK"):
        edges.ColoringVTK = 0
    lines = Show(edges, view)
    lines.ColorArrayName = ["POINTS", ""]
    lines.AmbientColor = lines.DiffuseColor = [0.0, 0.0, 0.0]
    lines.LineWidth = 1.5
    lines.Position = [0.0, 0.0, 1e-4 * SIZE]


def contact(view):
    """The slave surfaces as lines, and the pressure drawn outwards from them."""
    surfaces = series("contact")
    lines = Show(surfaces, view)
    lines.Representation = "Surface"
    lines.LineWidth = 4.0
    lines.Position = [0.0, 0.0, 2e-4 * SIZE]
    look = "Inferno (matplotlib)", PRESSURE, "contact pressure, Pa", "Lower Right Corner"
    coloured(lines, view, ("CELLS", "pressure"), *look)
    # The normal is the direction of the force on the slave: outwards is against it.
    combs = Glyph(registrationName="pressure", Input=CellCenters(Input=surfaces), GlyphType="Line")
    combs.OrientationArray = ["POINTS", "normal"]
    combs.ScaleArray = ["POINTS", "pressure"]
    combs.ScaleFactor = 0.1 * SIZE / PRESSURE
    combs.GlyphMode = "All Points"
    combs.GlyphTransform.Translate = [-0.5, 0.0, 0.0]  # from the surface on, instead of about it
    shown = Show(combs, view)
    shown.LineWidth = 3.0
    shown.Position = [0.0, 0.0, 3e-4 * SIZE]
    coloured(shown, view, ("POINTS", "pressure"), *look)


def coloured(shown, view, array, preset, top, title, place):
    """An array of points or cells in colours from 0 to its top; its bar."""
    ColorBy(shown, array)
    colours = GetColorTransferFunction(array[1])
    colours.ApplyPreset(preset, True)
    colours.AutomaticRescaleRangeMode = "Never"
    colours.RescaleTransferFunction(0.0, top)
    bar = GetScalarBar(colours, view)
    bar.Title, bar.ComponentTitle, bar.WindowLocation = title, "", place
    bar.TitleColor = bar.LabelColor = [0.0, 0.0, 0.0]
    bar.TitleFontSize, bar.LabelFontSize, bar.ScalarBarLength = 18, 16, 0.35
    bar.AddRangeLabels, bar.AutomaticLabelFormat, bar.LabelFormat = 0, 0, "%.3g"
    shown.SetScalarBarVisibility(view, True)


def labels(view):
    """The title and the time."""
    clock = AnnotateTimeFilter(registrationName="time", Input=FindSource("fields"))
    clock.Format = TITLE.replace("{", "(").replace("}", ")") + ", t = {time:.4g} s"
    text = Show(clock, view)
    text.WindowLocation, text.FontSize, text.Color = "Upper Center", 18, [0.0, 0.0, 0.0]


def camera(view):
    """All of the run, seen from the front."""
    middle = [0.5 * (a + b) for a, b in zip(LOW, HIGH)]
    view.CameraParallelProjection = 1
    view.InteractionMode = "2D"
    view.CameraFocalPoint = [middle[0] + 0.08 * (HIGH[0] - LOW[0]), middle[1], 0.0]
    view.CameraPosition = [view.CameraFocalPoint[0], middle[1], 3.0 * SIZE]
    view.CameraViewUp = [0.0, 1.0, 0.0]
    wide = 1.3 * (HIGH[0] - LOW[0]) * HEIGHT / WIDTH
    view.CameraParallelScale = 0.5 * max(1.15 * (HIGH[1] - LOW[1]), wide)


main()
'''
