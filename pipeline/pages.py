"""HTML pages that hold all that they show: templates, styles, scripts and data in one file."""

from __future__ import annotations

import json
import re
from base64 import b64encode
from functools import cache
from importlib import resources
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

if TYPE_CHECKING:
    from jinja2 import Environment
    from matplotlib.figure import Figure

PICTURE_DPI = 110


class Picture(NamedTuple):
    """A picture of a page: its bytes as a data URL, and what it shows."""

    source: str
    caption: str


class Cell(NamedTuple):
    """A cell of a table: text, style ("number", "good", "look" or ""), the page that it leads to."""

    text: str
    style: str = ""
    link: str = ""


class Table(NamedTuple):
    """A table of a page: names of its columns, and its rows."""

    columns: list[str]
    rows: list[list[Cell]]


def render(template: str, data: dict[str, Any], **content: Any) -> str:
    """A page.

    Parameters
    ----------
    template : str
        A file of ``page/``.
    data : dict
        What its script reads.
    **content
        What the template shows; all text is escaped.
    """
    from markupsafe import Markup

    # Within a script element nothing but "</" could end it, and "<!--" confuse it.
    text = json.dumps(data, allow_nan=False, separators=(",", ":")).replace("<", "\\u003c")
    return _environment().get_template(template).render(data=Markup(text), **content)


def picture_of(figure: Figure, caption: str) -> Picture:
    """A figure as a PNG within the page."""
    content = BytesIO()
    figure.savefig(content, format="png", dpi=PICTURE_DPI, bbox_inches="tight")
    return Picture(data_url(content.getvalue()), caption)


def picture_in(file: Path, caption: str) -> Picture:
    """A PNG file within the page."""
    return Picture(data_url(file.read_bytes()), caption)


def titled(file: Path) -> str:
    """The caption of a drawn file: profile.height.png is "Profile: height"."""
    kind, _, name = file.stem.partition(".")
    return f"{kind.capitalize()}: {name}"


def data_url(png: bytes) -> str:
    """A PNG as the address of itself."""
    return f"data:image/png;base64,{b64encode(png).decode()}"


@cache
def _environment() -> Environment:
    """Templates in which every value is escaped, and the files that they put in as they are."""
    from jinja2 import Environment, FunctionLoader, StrictUndefined
    from markupsafe import Markup

    environment = Environment(
        loader=FunctionLoader(_file), autoescape=True, undefined=StrictUndefined, trim_blocks=True
    )
    environment.globals |= {"asset": lambda name: Markup(_file(name)), "asset_text": _file}
    # A name of several words may go on in the next line, behind its dots and underscores.
    environment.filters["breakable"] = lambda name: re.sub(r"([._])", "\\1\u200b", name)
    return environment


@cache
def _file(name: str) -> str:
    """A file of ``page/``."""
    return resources.files("phantomnode.pipeline").joinpath("page", *name.split("/")).read_text("utf-8")
