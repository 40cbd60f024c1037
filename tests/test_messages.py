"""What the command line says: in logs, quietly, at length, without colours."""

from __future__ import annotations

import logging
import os
import re
import subprocess
import sys

import pytest
from small_run import TABLE

from phantomnode.pipeline.case import case_from_table, resolved_toml
from phantomnode.pipeline.cli import app

COLOUR = re.compile(r"\x1b\[[0-9;]*(?:3[0-7]|38|4[0-7]|48|9[0-7])[0-9;]*m")


@pytest.fixture(scope="module")
def case(tmp_path_factory):
    folder = tmp_path_factory.mktemp("case")
    (folder / "case.toml").write_text(resolved_toml(case_from_table(TABLE, folder, "small")))
    return folder / "case.toml"


def said(capsys, *line):
    """Standard output and errors of a command that is no terminal."""
    code = app([str(word) for word in line], result_action="return_value")
    out, err = capsys.readouterr()
    return code, out, err


class TestNoTerminal:
    def test_progress_is_whole_lines_without_control_characters(self, case, tmp_path, capsys):
        code, out, err = said(
            capsys, "run", case, "--out", tmp_path / "a_rather_long_name_of_a_folder" / "run"
        )
        assert (code, err) == (0, "")
        assert not re.search(r"[\x00-\x09\x0b-\x1f]", out)
        assert " 50%  t " in out and "can be trusted" in out
        # Paths and commands stand in one line each, to be copied.
        folder = tmp_path / "a_rather_long_name_of_a_folder" / "run"
        assert f"results   {folder}\n" in out and f"phantomnode report {folder}\n" in out

    def test_quiet_says_nothing_but_errors(self, case, tmp_path, capsys):
        assert said(capsys, "run", case, "-q", "--out", tmp_path / "run") == (0, "", "")
        assert said(capsys, "plot", tmp_path / "run", "--quiet") == (0, "", "")
        code, out, err = said(capsys, "run", tmp_path / "nothing.toml", "-q")
        assert (code, out) == (2, "") and err.startswith("error: ")

    def test_verbose_says_what_is_done_and_how_long_it_takes(self, case, tmp_path, capsys):
        logger = logging.getLogger("phantomnode")
        before = logger.level, list(logger.handlers)
        code, out, _ = said(capsys, "run", case, "-v", "--out", tmp_path / "run")
        assert code == 0
        for what in (
            "body disc: ",
            "prepared in ",
            "stable step",
            "the kernels are loaded",
            "manifest are written",
        ):
            assert re.search(rf"^ +\d+\.\d\d s  .*{what}", out, re.M), what
        assert (logger.level, logger.handlers) == before

    def test_both_at_once_is_refused(self, case, capsys):
        code, _, err = said(capsys, "check", case, "-q", "-v")
        assert code == 2 and "--quiet and --verbose: take one" in err


@pytest.mark.skipif(sys.platform == "win32", reason="terminals of POSIX")
class TestTerminal:
    def on_terminal(self, *line, **settings):
        """What a command writes to a terminal."""
        import pty

        mine, its = pty.openpty()
        environment = {**os.environ, "TERM": "xterm-256color", **settings}
        environment.pop("NO_COLOR", None) if "NO_COLOR" not in settings else None
        done = subprocess.Popen(
            [sys.executable, "-m", "phantomnode", *map(str, line)], stdout=its, stderr=its, env=environment
        )
        os.close(its)
        text = b""
        while True:
            try:
                piece = os.read(mine, 65536)
            except OSError:  # Linux tells the end of a terminal so
                break
            if not piece:
                break
            text += piece
        done.wait()
        os.close(mine)
        return text.decode()

    def test_no_color_is_obeyed(self, tmp_path):
        assert COLOUR.search(self.on_terminal("run", tmp_path / "nothing.toml"))
        assert not COLOUR.search(self.on_terminal("run", tmp_path / "nothing.toml", NO_COLOR="1"))
        assert not COLOUR.search(self.on_terminal("--help", NO_COLOR="1"))

    def test_a_dumb_terminal_gets_lines(self, case, tmp_path):
        text = self.on_terminal("run", case, "--out", tmp_path / "run", TERM="dumb")
        assert " 50%  t " in text and "\x1b[2K" not in text
