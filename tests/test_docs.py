"""What the pages say is so: their snippets run, their commands and keys exist, their links lead somewhere."""

from __future__ import annotations

import itertools
import json
import re
import shlex
from collections.abc import Iterator
from pathlib import Path

import pytest

from phantomnode.pipeline import cli
from phantomnode.pipeline.case import Case, case_from_table, json_schema, read_toml
from phantomnode.pipeline.reference import reference
from phantomnode.pipeline.starter import write_starter
from phantomnode.pipeline.sweep import load_study

ROOT = Path(__file__).parents[1]
PAGES = sorted([ROOT / "README.md", *ROOT.glob("*/*.md"), *ROOT.glob("tests/*/README.md")])
NAMES = [str(page.relative_to(ROOT)) for page in PAGES]


def snippets(page: Path, language: str) -> list[str]:
    """The fenced blocks of a page in a language."""
    return re.findall(rf"^```{language}\n(.*?)^```$", page.read_text(encoding="utf-8"), re.M | re.S)


def commands(page: Path) -> Iterator[list[str]]:
    """The words of every phantomnode command in the shell snippets of a page."""
    for block in snippets(page, "bash"):
        for line in block.replace("\\\n", " ").splitlines():
            for part in line.split("&&"):
                words = shlex.split(part, comments=True)
                if words and Path(words[0]).name == "phantomnode":
                    yield words[1:]


@pytest.mark.parametrize("page", PAGES, ids=NAMES)
def test_commands_and_their_options_exist(page: Path) -> None:
    for words in commands(page):
        cli.app.parse_args(words, print_error=False, exit_on_error=False)


@pytest.mark.parametrize("page", PAGES, ids=NAMES)
def test_cases_in_pages_are_sound(page: Path, tmp_path: Path) -> None:
    for block in snippets(page, "toml"):
        (tmp_path / "case.toml").write_text(block)
        table = read_toml(tmp_path / "case.toml")
        if "body" not in table and "base" not in table:  # a part of a case
            whole = read_toml(write_starter(tmp_path / "whole") / "case.toml")
            Case.model_validate({**whole, **table})
        elif "base" not in table:
            for body in table["body"].values():
                if "file" in body["geometry"]:
                    (tmp_path / body["geometry"]["file"]).touch()
            case_from_table(table, tmp_path)
        else:
            (tmp_path / "sweep.toml").write_text(block.replace('"case.toml"', '"ring_impact"'))
            load_study(tmp_path / "sweep.toml")


@pytest.mark.parametrize("page", PAGES, ids=NAMES)
def test_links_and_pictures_lead_somewhere(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    for target in re.findall(r"\]\(([^)\s]+)\)", re.sub(r"^```.*?^```$", "", text, flags=re.M | re.S)):
        if "://" in target:
            continue
        file, _, anchor = target.partition("#")
        path = (page.parent / file).resolve() if file else page
        assert path.exists(), target
        if anchor:
            titles = re.findall(r"^#+ (.*)$", path.read_text(encoding="utf-8"), re.M)
            assert anchor in {re.sub(r"[^\w\- ]", "", title).lower().replace(" ", "-") for title in titles}, (
                target
            )


@pytest.mark.parametrize("name", ["cases/tutorial.md", "cases/how_it_works.md"])
def test_the_page_runs_as_it_stands(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Its snippets in their order: commands are run, Python is executed, TOML becomes the case."""
    monkeypatch.chdir(tmp_path)
    text = (ROOT / name).read_text(encoding="utf-8")
    for language, block in re.findall(r"^```(\w+)\n(.*?)^```$", text, re.M | re.S):
        if language == "python":
            exec(compile(block, name, "exec"), {})
        elif language == "toml":
            Path("bumper/case.toml").write_text(block)
        else:
            for line in block.splitlines():
                assert cli.app(shlex.split(line)[1:], result_action="return_value") == 0, line
    expected = {
        "cases/tutorial.md": [
            "results/bumper/preview.png",
            "results/bumper/report.html",
            "results/finer/fields.pvd",
            "results/edge/fields.pvd",
        ],
        "cases/how_it_works.md": [
            "results/ring_impact/plot.nodes.png",
            "results/ring_impact/plot.level_set.png",
        ],
    }
    assert all(Path(file).is_file() for file in expected[name])
    for summary in Path("results").glob("*/summary.json"):
        assert all(check["passed"] for check in json.loads(summary.read_text())["checks"]), summary


def test_python_in_the_readme_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys) -> None:
    """One after the other, in one folder, as a reader would; what needs a cluster is compiled only."""
    monkeypatch.chdir(tmp_path)
    for block in snippets(ROOT / "README.md", "python"):
        code = compile(block, "README.md", "exec")
        if "dask_jobqueue" not in block:
            exec(code, {"__name__": "snippet"})
    assert "done" in capsys.readouterr().out


def test_the_reference_is_that_of_the_schema() -> None:
    """To mend it: phantomnode schema --markdown > pipeline/case_file.md."""
    assert (ROOT / "pipeline/case_file.md").read_text(encoding="utf-8") == reference()


def test_the_reference_names_every_key() -> None:
    schema, page = json_schema(), reference()
    tables = [schema, *schema["$defs"].values()]
    for key in itertools.chain.from_iterable(table.get("properties", ()) for table in tables):
        assert f"`{key}`" in page


def test_the_starter_brings_the_schema_that_its_first_line_names(tmp_path: Path) -> None:
    folder = write_starter(tmp_path / "start")
    first = (folder / "case.toml").read_text().splitlines()[0]
    assert first == "#:schema ./case.schema.json"
    assert json.loads((folder / "case.schema.json").read_text()) == json_schema()


def test_messages_that_are_explained_are_those_of_the_program() -> None:
    """The first column of the tables of troubleshooting.md."""
    sources = " ".join(
        re.sub(r'"\s*\n\s*f?"', "", file.read_text(encoding="utf-8"))
        for package in ("pipeline", "geometry", "solver")
        for file in (ROOT / package).glob("*.py")
    )
    rows = re.findall(
        r"^\| (.*?) \|", (ROOT / "pipeline/troubleshooting.md").read_text(encoding="utf-8"), re.M
    )
    quoted = [words for row in rows for words in re.findall(r"`([^`]+)`", row)]
    assert len(quoted) > 10
    for words in quoted:
        assert words in sources, words
