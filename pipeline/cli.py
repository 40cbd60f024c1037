"""The command line: ``phantomnode run | batch | check | cases | inspect | new | report | plot | ...``.

Everything heavy is imported inside the commands, so that ``--help`` answers at once.
"""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import App, Parameter

import phantomnode
from phantomnode.pipeline.cli_files import inspect, new
from phantomnode.pipeline.cli_pictures import animate, paraview, plot
from phantomnode.pipeline.console import DONE, INTERRUPTED, SOME_FAILED, STOPPED, TALK, Talk, guarded
from phantomnode.pipeline.places import RESULTS, folder_to_resume, results_folder

if TYPE_CHECKING:
    from rich.console import Console


CaseSource = Annotated[
    str,
    Parameter(name="CASE", help="A case file, a folder that holds case.toml, or the name of a bundled case."),
]
Overrides = Annotated[
    tuple[str, ...],
    Parameter(
        name="--set",
        negative=(),
        show_default=False,
        help="Change any key of the case, as in --set time.end=0.005; can be repeated. The value is TOML; a "
        "number in the path is the place in a list, counted from 0.",
    ),
]

app = App(
    name="phantomnode",
    version=phantomnode.__version__,
    help="""From a CAD curve to a dynamic contact-impact run in ParaView, with no mesh that fits the geometry.

Start with `phantomnode run ring_impact`, or with `phantomnode new my_case` for a case of your own.

Exit codes: 0 done, 2 the input is at fault, 3 a guard stopped the run, 4 some cases of a batch failed,
130 interrupted.""",
    help_format="markdown",
)


@app.command
def run(
    case: CaseSource,
    /,
    *,
    out: Annotated[
        Path | None, Parameter(help="Folder for the results; results/NAME (or NAME-2, ...) unless given.")
    ] = None,
    set_: Overrides = (),
    overwrite: Annotated[
        bool, Parameter(negative=(), show_default=False, help="Write over a finished run in --out.")
    ] = False,
    resume: Annotated[
        bool,
        Parameter(
            negative=(),
            show_default=False,
            help="Go on where an unfinished run of this case stopped, to the same bits: in --out, in CASE where that "
            "is the folder of a run, else in the last such folder of results/NAME, NAME-2, ...",
        ),
    ] = False,
    checkpoint_every: Annotated[
        str | None,
        Parameter(
            help='How often to write all that is needed to go on: "0.5 ms" of simulated time, "1000 steps", or wall '
            'time as "10 min" or "30 s wall"; as the case says ("10 min") unless given. Two are kept.'
        ),
    ] = None,
    wall_limit: Annotated[
        str | None,
        Parameter(
            help='The time that a queue allows, as "23:50:00" or "2 h": the run ends before it with a checkpoint and '
            "the exit code 130."
        ),
    ] = None,
    threads: Annotated[
        int,
        Parameter(
            help="Threads that may take part in a step, 1 unless given; the results are the same, to the bit, at "
            "any number. Small models and classic X-FEM keep to one, and the run says so."
        ),
    ] = 1,
    talk: Talk = TALK,
) -> int:
    """Run a case, and its variants where it has some, and write the results.

    For example:

    ```
    phantomnode run ring_impact
    phantomnode run ring_impact --out fast --set "body.ring.initial_velocity=[0,-100]"
    phantomnode run my_case/case.toml --set time.end=0.002 --set time.step=1e-7
    phantomnode run my_case --checkpoint-every "5 min" --wall-limit 11:50:00
    phantomnode run results/my_case --resume
    ```
    """

    def command(console: Console) -> int:
        from phantomnode.pipeline.case import CaseError, find_case, load_case

        if resume and overwrite:
            raise CaseError(
                "--resume and --overwrite: one goes on with a run, the other starts again; take one"
            )
        loaded, source = load_case(case, set_), find_case(case)
        if resume:
            folder = folder_to_resume(loaded, out, source)
        else:
            folder = results_folder(loaded, out, source, overwrite)
        from phantomnode.pipeline.run import run_all  # the solver: only for a case that is sound

        line = ("phantomnode", *sys.argv[1:])
        summaries = run_all(
            loaded, folder, console=console, command=line, threads=threads, resume=resume,
            checkpoint_every=checkpoint_every, wall_limit=wall_limit,
        )  # fmt: skip
        codes = {"done": DONE, "stopped": STOPPED, "interrupted": INTERRUPTED}
        return max(codes[summary.status] for summary in summaries)

    return guarded(command, talk)


@app.command
def batch(
    sweep: Annotated[
        str,
        Parameter(
            name="SWEEP",
            help="A sweep file, a folder that holds sweep.toml, or the name of a bundled case with one.",
        ),
    ],
    /,
    *,
    out: Annotated[Path | None, Parameter(help="Folder for the results; results/NAME unless given.")] = None,
    workers: Annotated[
        int | None, Parameter(help="Processes on this machine; as many as its cores allow unless given.")
    ] = None,
    threads: Annotated[int, Parameter(help="Threads of each worker, 1 unless given.")] = 1,
    checkpoint_every: Annotated[
        str | None, Parameter(help="How often each case writes a checkpoint, as for run.")
    ] = None,
    wall_limit: Annotated[
        str | None,
        Parameter(
            help='The time that a queue allows, as "23:50:00" or "2 h": before it, the cases that run write a '
            "checkpoint, and the batch ends with the exit code 130."
        ),
    ] = None,
    scheduler: Annotated[
        str | None,
        Parameter(help="Address of a running dask scheduler, as tcp://host:8786; its workers are used."),
    ] = None,
    resume: Annotated[
        bool,
        Parameter(negative=(), show_default=False, help="Go on: cases that have ended are left as they are."),
    ] = False,
    only_failed: Annotated[
        bool, Parameter(negative=(), show_default=False, help="Go on, with the cases that failed only.")
    ] = False,
    dry_run: Annotated[
        bool, Parameter(negative=(), show_default=False, help="Print the cases; run and write nothing.")
    ] = False,
    talk: Talk = TALK,
) -> int:
    """Run all cases of a sweep on several processes; write results.csv and plots.

    For example:

    ```
    phantomnode batch ring_impact --dry-run
    phantomnode batch my_case/sweep.toml --out study --workers 8
    phantomnode batch my_case/sweep.toml --out study --resume
    ```
    """

    def command(console: Console) -> int:
        from phantomnode.pipeline.batch import run_batch, show_plan

        if dry_run:
            show_plan(sweep, out, console)
            return DONE
        line = ("phantomnode", *sys.argv[1:])
        ended = run_batch(
            sweep, out, workers=workers, threads=threads, scheduler=scheduler, resume=resume,
            only_failed=only_failed, checkpoint_every=checkpoint_every, wall_limit=wall_limit,
            console=console, command=line,
        )  # fmt: skip
        return {"done": DONE, "failed": SOME_FAILED, "interrupted": INTERRUPTED}[ended.status]

    return guarded(command, talk)


@app.command
def check(
    case: CaseSource,
    /,
    *,
    out: Annotated[
        Path | None, Parameter(help="Folder for preview.png and preview.vtu; results/NAME unless given.")
    ] = None,
    set_: Overrides = (),
    talk: Talk = TALK,
) -> int:
    """Validate and prepare a case, report what a run would do, draw a preview; run no step.

    For example:

    ```
    phantomnode check ring_impact
    phantomnode check my_case --set body.disc.grid.cell=0.002
    ```
    """

    def command(console: Console) -> int:
        from phantomnode.pipeline.case import load_case

        loaded = load_case(case, set_)
        from phantomnode.pipeline.run import check as check_case  # the solver: only for a case that is sound

        check_case(loaded, out or RESULTS / loaded.name, console=console)
        return DONE

    return guarded(command, talk)


@app.command
def cases() -> int:
    """List the bundled cases; their names work wherever a CASE is asked for."""

    def command(console: Console) -> int:
        import tomllib

        from phantomnode.pipeline.case import bundled_cases

        found = bundled_cases()
        width = max(map(len, found))
        for name, file in found.items():
            title = tomllib.loads(file.read_text(encoding="utf-8")).get("title", "")
            console.print(f"[bold]{name:{width}}[/]  {title}", highlight=False)
        console.print(f"\nRun one: phantomnode run {next(iter(found))}", highlight=False)
        return DONE

    return guarded(command)


app.command(inspect)
app.command(new)


@app.command
def report(
    folders: Annotated[
        tuple[Path, ...], Parameter(name="DIR", help="Results folders of runs, or one of a batch.")
    ],
    /,
    *,
    out: Annotated[
        Path | None, Parameter(help="Folder for the page and the pictures; the first DIR unless given.")
    ] = None,
    talk: Talk = TALK,
) -> int:
    """Write one HTML page of a run or a batch; of several runs, one that compares them. Draw its figures.

    The page needs no network: whether the run can be trusted and why, pictures, histories and contact pressures to
    point at, the bodies over time to move about in, timings, where it comes from. The figures that the case or sweep
    asks for are drawn, and profiles of runs over each other.

    For example:

    ```
    phantomnode report results/ring_impact
    phantomnode report results/block_contact_sweep
    phantomnode report results/coarse results/fine --out results
    ```
    """

    def command(console: Console) -> int:
        from phantomnode.pipeline.report import write_report

        for file in write_report(folders, out or folders[0]):
            what = "report  " if file.suffix == ".html" else "picture "
            console.print(f"{what}  {file}", soft_wrap=True, highlight=False)
        return DONE

    return guarded(command, talk)


app.command(plot)
app.command(animate)
app.command(paraview)


@app.command
def schema(
    *,
    markdown: Annotated[
        bool,
        Parameter(negative=(), show_default=False, help="Print the reference of all keys as a page instead."),
    ] = False,
) -> int:
    """Print the JSON schema of a case file, for editors that complete and check TOML.

    For example:

    ```
    phantomnode schema > case.schema.json
    phantomnode schema --markdown
    ```
    """
    if markdown:
        from phantomnode.pipeline.reference import reference

        print(reference(), end="")
        return DONE
    from phantomnode.pipeline.case import schema_text

    print(schema_text(), end="")
    return DONE


def main() -> None:
    """The console script."""
    try:
        app()
    except BrokenPipeError:  # the reader of a pipe, such as head, has seen enough
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
