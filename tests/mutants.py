"""Damaged files by the thousand: none may crash, stop or confuse the process that reads them.

``python -m tests.mutants [COUNT] [SEED] [JOBS]`` prints what became of each kind. The number of a mutant and the seed
give it back: ``mutant(sources()[k], random(seed, number))``.
"""

from __future__ import annotations

import importlib
import os
import re
import subprocess
import sys
import tempfile
import time
import traceback
from collections import Counter
from concurrent.futures import ProcessPoolExecutor
from contextlib import suppress
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path
from typing import NoReturn

import ezdxf
import numpy as np

from phantomnode.geometry import child, reading_child
from phantomnode.geometry.errors import GeometryError
from phantomnode.geometry.readers import read_geometry

try:
    from cad import by_gmsh
except ImportError:  # as a program, from the root
    from tests.cad import by_gmsh

CAP = 10.0
"""Seconds allowed to a file; ten times what an undamaged one needs on a busy machine."""

SLACK = 5.0
"""Seconds for starting and ending the process that reads it, on a busy machine."""

PLATE = """
occ.addRectangle(0, 0, 0, 40, 20, 1, 3); occ.addDisk(10, 10, 0, 4, 3, 2); occ.cut([(2, 1)], [(2, 2)])
occ.synchronize(); model.addPhysicalGroup(2, [1], name='plate'); mesh.setSize(model.getEntities(0), 4)
"""
BLOCK = "occ.addBox(0, 0, 0, 40, 20, 10, 1); occ.addCylinder(10, 10, 0, 0, 0, 10, 4, 2)\n"
BLOCK += "occ.cut([(3, 1)], [(3, 2)]); occ.synchronize()"
SCRIPT = """// an arch
r = 5; n = 4; lc = 0.5;
Point(1) = {0, 0, 0, lc}; Point(2) = {r, 0, 0, lc}; Point(3) = {0, r, 0, lc}; Point(4) = {-r, 0, 0, lc};
For k In {1:n}
  Point(10 + k) = {-3 + 6*k/n, -2*Sin(Pi*k/n), 0, lc};
EndFor
Circle(1) = {2, 1, 3}; Circle(2) = {3, 1, 4}; Line(3) = {4, 11}; Spline(4) = {11:10+n}; Line(5) = {10+n, 2};
Curve Loop(1) = {1:5}; Plane Surface(1) = {1};
Physical Surface("arch") = {1}; Physical Curve("crown") = {1, 2};
"""


@dataclass(frozen=True)
class Source:
    """An undamaged file and what is wanted of it."""

    name: str
    content: bytes
    section: tuple[str, float] | None = None


@dataclass(frozen=True)
class Outcome:
    """What became of one mutant."""

    source: str
    number: int
    what: str
    seconds: float


def sources(folder: Path) -> tuple[Source, ...]:
    """One file of each kind, planar, and a solid to be cut."""
    names = by_gmsh(folder, PLATE, "a.step", "a.igs", "a.brep")
    names += by_gmsh(folder, PLATE + "mesh.generate(2)", "a.msh")
    planar = tuple(Source(path.name, path.read_bytes()) for path in names)
    solid = by_gmsh(folder, BLOCK, "solid.step", "solid.brep")
    cut = tuple(Source(path.name, path.read_bytes(), ("z", 0.004)) for path in solid)
    return (*planar, *cut, Source("a.geo", SCRIPT.encode()), Source("a.dxf", _drawing(folder / "a.dxf")))


def _drawing(path: Path) -> bytes:
    """A drawing with every kind of curve, a hatch and a block."""
    document = ezdxf.new("R2010")
    space = document.modelspace()
    space.add_lwpolyline([(0, 0, 0, 0, 0), (40, 0, 0, 0, 1), (40, 20, 0, 0, 0), (0, 20, 0, 0, 0)], close=True)
    space.add_ellipse((20, 10), (8, 0), 0.5)
    space.add_spline([(50, 0), (55, 5), (60, 0)])
    space.add_line((60, 0), (50, 0))
    space.add_polyline2d([(70, 0), (80, 0), (80, 8)], close=True)
    space.add_hatch().paths.add_polyline_path([(90, 0), (95, 0), (95, 5)])
    document.blocks.new("HOLE").add_circle((0, 0), 1)
    space.add_blockref("HOLE", (5, 5), dxfattribs={"xscale": 2.0, "yscale": 2.0, "rotation": 30.0})
    document.saveas(path)
    return path.read_bytes()


def random(seed: int, number: int) -> np.random.Generator:
    """The dice of one mutant."""
    return np.random.default_rng([seed, number])


def mutant(content: bytes, dice: np.random.Generator) -> bytes:
    """The content with one kind of damage."""
    lines = content.split(b"\n")
    kind = dice.integers(5)
    if kind == 0:  # bytes flipped
        damaged = bytearray(content)
        for place in dice.integers(len(content), size=dice.integers(1, 9)):
            damaged[place] ^= 1 << dice.integers(8)
        return bytes(damaged)
    if kind == 1:  # cut off, half of them with the last lines in place
        whole = b"\n".join(lines[-3:]) if dice.integers(2) else b""
        return content[: dice.integers(len(content))] + b"\n" + whole
    if kind == 2:  # lines swapped
        for a, b in dice.integers(len(lines), size=(dice.integers(1, 4), 2)):
            lines[a], lines[b] = lines[b], lines[a]
    elif kind == 3:  # lines lost or doubled
        place = dice.integers(len(lines))
        lines[place : place + 1] = lines[place : place + 1] * int(2 * dice.integers(2))
    else:  # a number replaced
        wrong = [b"0", b"-1", b"1e308", b"-1e-308", b"nan", b"999999999999", b"", b"7", b"9" * 5000]
        numbers = list(re.finditer(rb"-?\d+\.?\d*(?:[eE][-+]?\d+)?", content))
        found = numbers[dice.integers(len(numbers))]
        return content[: found.start()] + wrong[dice.integers(len(wrong))] + content[found.end() :]
    return b"\n".join(lines)


def outcome(source: Source, seed: int, number: int) -> Outcome:
    """Read one mutant: "regions", "curves", "refused", or the name of an exception that must not be."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, source.name)
        path.write_bytes(mutant(source.content, random(seed, number)))
        start = time.monotonic()
        try:
            geometry = read_geometry(path, "mm", time_limit=CAP, section=source.section)
        except GeometryError as error:
            what = f"broken: {error}"[-300:] if "broke down (exit code" in str(error) else "refused"
        except Exception as error:
            what = f"{type(error).__name__}: {error}"
        else:
            areas = [region.area for region in geometry.regions]
            what = "curves" if not areas else "regions" if np.all(np.array(areas) > 0.0) else f"areas {areas}"
        return Outcome(source.name, number, what, time.monotonic() - start)


class Forked:
    """What ``child._started`` begins, by a fork of this process instead of a new one: ten times as fast.

    The libraries are there already; limits, reading and answer are the same.
    """

    def __init__(self, arguments: list[str], folder: str) -> None:
        self._said = Path(folder, "said")
        self.returncode: int | None = None
        self.stderr = None
        self.pid = os.fork()
        if self.pid == 0:
            self._read(arguments, folder)
        with suppress(PermissionError, ProcessLookupError):  # the child does it, too: whoever comes first
            os.setpgid(self.pid, self.pid)

    def _read(self, arguments: list[str], folder: str) -> NoReturn:
        code = 1
        try:
            os.setpgid(0, 0)
            os.chdir(folder)
            os.dup2(os.open(self._said, os.O_WRONLY | os.O_CREAT), 2)
            os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
            reading_child.main(arguments)
            code = 0
        except BaseException:
            traceback.print_exc()
        finally:
            os._exit(code)

    def poll(self) -> int | None:
        """The exit status, once it has ended."""
        if self.returncode is None and (ended := os.waitpid(self.pid, os.WNOHANG))[0]:
            self.returncode = os.waitstatus_to_exitcode(ended[1])
        return self.returncode

    def wait(self, timeout: float = CAP) -> None:
        """Wait for its end."""
        latest = time.monotonic() + timeout
        while self.poll() is None:
            if time.monotonic() > latest:
                raise subprocess.TimeoutExpired("a reader", timeout)
            time.sleep(0.002)

    def communicate(self, timeout: float) -> tuple[bytes, bytes]:
        """Wait for it; what it complained of."""
        self.wait(timeout)
        return b"", self._said.read_bytes() if self._said.exists() else b""


def outcomes(count: int, seed: int, jobs: int = 1, *, forked: bool = False) -> list[Outcome]:
    """What became of ``count`` mutants, taken in turn from the kinds of files; ``forked`` for this process's life."""
    with tempfile.TemporaryDirectory() as folder:
        found = sources(Path(folder))
    if forked:
        for library in ("gmsh", "ezdxf", "shapely", "scipy.spatial", "scipy.sparse.csgraph"):
            importlib.import_module(library)
        child._started = Forked
    turns = [found[number % len(found)] for number in range(count)]
    if jobs == 1:
        return [outcome(source, seed, number) for number, source in enumerate(turns)]
    with ProcessPoolExecutor(
        jobs, get_context("fork") if forked else None
    ) as pool:  # a process that dies raises here
        return list(pool.map(outcome, turns, [seed] * count, range(count), chunksize=8))


def good(found: Outcome) -> bool:
    """Whether a mutant ended as every file must, in time."""
    return found.what in ("regions", "curves", "refused") and found.seconds < CAP + SLACK


def main(count: int = 2000, seed: int = 7, jobs: int = 2) -> int:
    """Print the table; the number of mutants that ended as none may."""
    found = outcomes(count, seed, jobs, forked=hasattr(os, "fork"))
    print(f"{count} mutants, seed {seed}; longest {max(o.seconds for o in found):.1f} s")
    for name in sorted({o.source for o in found}):
        kind = Counter(o.what if good(o) else "BAD" for o in found if o.source == name)
        print(f"{name:12s}", dict(sorted(kind.items())))
    bad = [o for o in found if not good(o)]
    for o in bad:
        print(o)
    return len(bad)


if __name__ == "__main__":
    sys.exit(min(1, main(*map(int, sys.argv[1:]))))
