"""The commands that show results: ``phantomnode plot | animate | paraview``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from phantomnode.pipeline.console import DONE, TALK, Talk, guarded

if TYPE_CHECKING:
    from rich.console import Console

Folder = Annotated[Path, Parameter(name="DIR", help="The results folder of a run.")]
Limits = Annotated[
    tuple[float, float] | None,
    Parameter(
        name="--range", negative=(), help="Values at the ends of the colour bar, SI, as in --range 0 5e8."
    ),
]
Zoom = Annotated[
    tuple[float, float, float, float] | None,
    Parameter(negative=(), help="What is shown: lower left and upper right corner, x0 y0 x1 y1 in m."),
]

Smooth = Annotated[
    bool,
    Parameter(
        negative=(),
        show_default=False,
        help="Draw fields as means over neighbouring cells, which reads better in thin walls; peaks are lower.",
    ),
]


def plot(
    folder: Folder,
    /,
    *,
    what: Annotated[
        tuple[str, ...],
        Parameter(
            consume_multiple=True,
            negative=(),
            show_default=False,
            help="Pictures, von_mises unless given: fields (von_mises, J, stress_xx, stress_yy, stress_zz, "
            "stress_xy, mean_stress, principal_max, principal_min, strain_xx, strain_yy, strain_xy, "
            "displacement, velocity, each of these two with _x or _y), contact_pressure over arc length, "
            "histories (energies, forces, impulses, reactions, motion, quality, or any column of history.csv), "
            "level_set (with grid and relocated nodes), nodes (fragments, real and phantom nodes).",
        ),
    ] = ("von_mises",),
    time: Annotated[
        tuple[str, ...],
        Parameter(
            consume_multiple=True,
            negative=(),
            show_default=False,
            help='Of fields and contact_pressure: "4.5 ms" or 0.0045, start, end, or peak (of the internal energy); '
            "several give a picture of a field each, and curves of the pressure in one. The nearest frame is drawn. "
            "Unless given, fields are drawn at the peak, and the pressure at some times while the pair bears.",
        ),
    ] = (),
    out: Annotated[
        Path | None,
        Parameter(help="A file that ends in .png, .svg or .pdf, or a folder; that of the run unless given."),
    ] = None,
    pair: Annotated[str | None, Parameter(help="The contact pair; the first unless given.")] = None,
    range_: Limits = None,
    zoom: Zoom = None,
    smooth: Smooth = False,
    talk: Talk = TALK,
) -> int:
    """Draw pictures of a run: fields, contact pressure, histories, level sets, nodes.

    For example:

    ```
    phantomnode plot results/ring_impact
    phantomnode plot results/ring_impact --what stress_yy --time "4.5 ms" --out stress.svg
    phantomnode plot results/ring_impact --what energies forces contact_pressure
    phantomnode plot results/ring_impact --what nodes --zoom 0.4 0.4 0.6 0.6
    ```
    """

    def command(console: Console) -> int:
        from phantomnode.pipeline.plot import parse_time, plot_files
        from phantomnode.pipeline.results import open_results

        times = [parse_time(text) for text in time]
        written = plot_files(
            open_results(folder), what, times, out, pair=pair, limits=range_, box=zoom, smooth=smooth
        )
        for path, note in written:
            if note:
                console.print(note, soft_wrap=True, highlight=False, markup=False)
            console.print(f"picture   {path}", soft_wrap=True, highlight=False, markup=False)
        return DONE

    return guarded(command, talk)


def animate(
    folder: Folder,
    /,
    *,
    what: Annotated[str, Parameter(help="The field, as for plot.")] = "von_mises",
    out: Annotated[
        Path | None,
        Parameter(
            help="The file, .gif or .mp4 (which needs ffmpeg); animation.WHAT.gif in the folder unless given."
        ),
    ] = None,
    fps: Annotated[int, Parameter(help="Frames a second.")] = 15,
    width: Annotated[int, Parameter(help="Of the film, in pixels.")] = 800,
    range_: Limits = None,
    zoom: Zoom = None,
    smooth: Smooth = False,
    talk: Talk = TALK,
) -> int:
    """Make a film of a field over all frames of a run, as GIF or MP4.

    For example:

    ```
    phantomnode animate results/ring_impact
    phantomnode animate results/ring_impact --what velocity --out ring.mp4 --fps 25
    ```
    """

    def command(console: Console) -> int:
        from phantomnode.pipeline.film import write_film
        from phantomnode.pipeline.results import open_results

        film = write_film(
            open_results(folder),
            what,
            out,
            fps=fps,
            width=width,
            limits=range_,
            box=zoom,
            smooth=smooth,
            console=console,
        )
        console.print(f"film      {film}", soft_wrap=True, highlight=False, markup=False)
        return DONE

    return guarded(command, talk)


def paraview(
    folder: Folder,
    /,
    *,
    open_: Annotated[
        bool, Parameter(name="--open", negative=(), show_default=False, help="Start ParaView with it.")
    ] = False,
    vtkhdf: Annotated[
        bool,
        Parameter(
            negative=(),
            show_default=False,
            help="Write all frames into fields.vtkhdf and contact.vtkhdf, for ParaView 5.12 or later (needs h5py).",
        ),
    ] = False,
    talk: Talk = TALK,
) -> int:
    """Write in_paraview.py into the folder of a run: a view of it in ParaView, set up.

    It shows the von Mises stress on the deformed bodies and the contact pressure as lines, with ranges that hold for
    the whole run. For example:

    ```
    phantomnode paraview results/ring_impact --open
    paraview --script=results/ring_impact/in_paraview.py
    pvbatch results/ring_impact/in_paraview.py picture.png 0.0021
    ```
    """

    def command(console: Console) -> int:
        from phantomnode.pipeline.paraview import open_paraview, write_script
        from phantomnode.pipeline.results import open_results

        script = write_script(open_results(folder))
        console.print(f"script    {script}", soft_wrap=True, highlight=False, markup=False)
        if vtkhdf:
            from phantomnode.pipeline.vtkhdf import write_vtkhdf

            for file in write_vtkhdf(open_results(folder)):
                console.print(f"series    {file}", soft_wrap=True, highlight=False, markup=False)
        if open_:
            open_paraview(script)
        else:
            line = f"look at   paraview --script={script}"
            console.print(line, soft_wrap=True, highlight=False, markup=False)
        return DONE

    return guarded(command, talk)
