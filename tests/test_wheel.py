"""The wheel and the sdist hold everything, and the installed package works outside the checkout."""

from __future__ import annotations

import subprocess
import sys
import tarfile
import venv
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the sdist of a copy of the checkout, and the wheel made from the sdist."""
    folder = tmp_path_factory.mktemp("dist")
    command = [sys.executable, "-m", "build", "--outdir", str(folder), str(ROOT)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=600)
    assert done.returncode == 0, done.stdout[-3000:] + done.stderr[-3000:]
    return folder


def sources() -> set[str]:
    """What the wheel must hold: every module, every data file of the cases and of the report pages."""
    names = ("__init__.py", "__main__.py", "kernels.py", "py.typed")
    wanted = {f"phantomnode/{name}" for name in names}
    for package in ("geometry", "solver", "pipeline", "cases"):
        wanted |= {f"phantomnode/{package}/{file.name}" for file in (ROOT / package).glob("*.py")}
    for kind in ("toml", "dxf", "step", "brep", "geo_unrolled", "msh"):
        wanted |= {f"phantomnode/{file.relative_to(ROOT)}" for file in (ROOT / "cases").glob(f"*/*.{kind}")}
    pages = [file for file in (ROOT / "pipeline" / "page").rglob("*") if file.is_file()]
    return wanted | {f"phantomnode/{file.relative_to(ROOT).as_posix()}" for file in pages}


def test_the_wheel_holds_every_module_and_case_file(built: Path) -> None:
    names = set(zipfile.ZipFile(next(built.glob("*.whl"))).namelist())
    assert sources() <= names
    assert not [name for name in names if name.startswith(("tests", "geometry", "solver", "pipeline"))]


def test_the_sdist_holds_the_tests_and_the_readme(built: Path) -> None:
    with tarfile.open(next(built.glob("*.tar.gz"))) as archive:
        names = {name.partition("/")[2] for name in archive.getnames()}
    assert {"README.md", "pyproject.toml", "tests/test_wheel.py", "cases/ring_impact/ring.dxf"} <= names


def test_the_installed_wheel_finds_its_cases(built: Path, tmp_path: Path) -> None:
    """Installed without its dependencies into an environment that borrows them from this one."""
    environment = tmp_path / "venv"
    venv.create(environment, with_pip=True, symlinks=True)
    python = environment / "bin" / "python"
    wheel = next(built.glob("*.whl"))
    subprocess.run(
        [python, "-m", "pip", "install", "--quiet", "--no-deps", str(wheel)], check=True, timeout=300
    )
    own = next(environment.glob("lib/python*/site-packages"))
    borrowed = [path for path in sys.path if path.endswith("site-packages")]
    (own / "borrowed.pth").write_text("\n".join(borrowed))  # plain paths: an editable install stays behind
    where = subprocess.check_output(
        [python, "-c", "import phantomnode.cases as c; print(c.__file__)"], text=True, cwd=tmp_path
    )
    assert where.startswith(str(own))
    command = [python, "-m", "phantomnode", "check", "ring_impact"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "results" / "ring_impact" / "preview.png").stat().st_size > 10_000
