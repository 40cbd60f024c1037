"""How results show in a notebook: what was run, whether it can be trusted, the picture of its peak."""

from __future__ import annotations

from base64 import b64encode
from html import escape
from typing import TYPE_CHECKING

from phantomnode.pipeline.drawing import moment

if TYPE_CHECKING:
    from phantomnode.pipeline.results import Results


def results_html(results: Results) -> str:
    """A heading, the checks of the summary with the figures behind them, and peak.png where it is there."""
    summary, rows = results.summary, list[str]()
    status = summary.get("status", "not ended yet")
    frames = f"{len(results.times)}, to {moment(float(results.times[-1]))}" if len(results.times) else "none"
    rows += [_row("folder", str(results.path)), _row("status", status), _row("frames", frames)]
    if "steps" in summary:
        rows.append(_row("steps", f"{summary['steps']} of {moment(summary['dt'])}"))
    for check in summary.get("checks", ()):
        word = "kept" if check["passed"] else f"<b>not kept</b>: {escape(check['advice'])}"
        rows.append(_row(check["name"], f"{check['value']:.3g}, limit {check['limit']:g}: {word}", safe=True))
    picture = ""
    if (results.path / "peak.png").is_file():
        data = b64encode((results.path / "peak.png").read_bytes()).decode()
        picture = (
            f'<img alt="the frame of largest internal energy" width="420" src="data:image/png;base64,{data}">'
        )
    return f"<div><b>{escape(results.title)}</b><table>{''.join(rows)}</table>{picture}</div>"


def _row(name: str, value: str, safe: bool = False) -> str:
    """A row of the table; the value is text unless it is ``safe`` HTML already."""
    return f"<tr><td>{escape(name)}</td><td>{value if safe else escape(value)}</td></tr>"
