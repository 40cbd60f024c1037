"""The bytes of a DXF file as an ezdxf document, mended where its structure is not that of the standard."""

from __future__ import annotations

import io
import logging
import re
import struct
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from phantomnode.geometry.errors import GeometryError

BINARY = b"AutoCAD Binary DXF\r\n\x1a\x00"
"""How a binary DXF file begins."""

MOST_BYTES = 40_000_000
"""Of a DXF file. ezdxf loads 1.7 MB/s (0.8 MB/s where it has to recover) into twenty times the memory."""

MARKERS = {
    "LWPOLYLINE": "AcDbPolyline",
    "SPLINE": "AcDbSpline",
    "MLINE": "AcDbMline",
    "LEADER": "AcDbLeader",
    "MTEXT": "AcDbMText",
    "MESH": "AcDbSubDMesh",
    "MULTILEADER": "AcDbMLeader",
}
"""Entities that ezdxf does not load without their subclass marker, which many programs leave out."""

_BASE = {"5", "102", "330", "360"}
_COMMON = {
    "6",
    "8",
    "48",
    "60",
    "62",
    "67",
    "284",
    "347",
    "348",
    "370",
    "380",
    "390",
    "410",
    "420",
    "430",
    "440",
}
"""Group codes of every entity that stand before its own (DXF reference, common group codes)."""


def load(content: bytes) -> tuple[Any, list[str]]:
    """The ezdxf document of an ASCII or binary DXF file, and notes on what had to be mended.

    Raises
    ------
    GeometryError
        Where the file is too large or damaged beyond that.
    """
    if len(content) > MOST_BYTES:
        raise GeometryError(
            f"the DXF file has {len(content) / 1e6:.0f} MB, and more than {MOST_BYTES / 1e6:.0f} MB are not read: "
            "purge it and keep the outline only"
        )
    return _document(_from_binary(content) if content.startswith(BINARY) else _decoded(content))


def is_whole(content: bytes) -> bool:
    """Whether the end of the file is there: the mark EOF, or at least that of the section of entities."""
    if content.startswith(BINARY):
        return re.search(rb"\0{1,2}EOF\0\s*$", content[-100:]) is not None
    text = content.decode("latin-1").replace("\r\n", "\n").replace("\r", "\n")
    if re.search(r"\n\s*0\s*\n\s*EOF\s*$", text[-20_000:]):
        return True
    start = re.search(r"(^|\n)\s*2\s*\nENTITIES\s*\n", text)
    return start is not None and re.search(r"\n\s*0\s*\n\s*ENDSEC\s*(\n|$)", text[start.end() :]) is not None


def _document(text: str) -> tuple[Any, list[str]]:
    """The document as it stands; else with subclass markers; else as the recover mode of ezdxf gives it."""
    import ezdxf
    from ezdxf import recover

    notes: list[str] = []
    if not re.search(r"\n\s*0\s*\n\s*EOF\s*$", text[-20_000:]):
        notes.append("the DXF file ends after its entities, without the mark EOF")
        text = text.rstrip() + "\n0\nEOF\n"
    try:
        return ezdxf.read(io.StringIO(text)), notes
    except (ezdxf.DXFError, ValueError, TypeError, KeyError, AttributeError, IndexError):
        pass  # many real drawings miss required tags
    text, added = _marked(text)
    notes += [f"the DXF file has {count} {kind} without subclass markers" for kind, count in added.items()]
    if added:
        try:
            return ezdxf.read(io.StringIO(text)), notes
        except (ezdxf.DXFError, ValueError, TypeError, KeyError, AttributeError, IndexError):
            pass  # something else is wrong as well
    try:
        document, auditor = recover.read(io.BytesIO(text.encode("utf-8", errors="replace")))
    except Exception as error:  # ezdxf raises many kinds on damaged files
        raise GeometryError(f"the DXF file is damaged ({error}); export it again") from error
    return document, [*notes, *_audit(auditor)]


def _audit(auditor: Any) -> list[str]:
    """What the recover mode found, the first few in full."""
    found = [str(entry.message) for entry in (*auditor.errors, *auditor.fixes)]
    listed = "; ".join(found[:3]) + (f"; and {len(found) - 3} more" if len(found) > 3 else "")
    return [
        "the DXF file does not keep to the standard and was recovered" + (f": {listed}" if listed else "")
    ]


def _decoded(content: bytes) -> str:
    """The text of an ASCII DXF file: UTF-8 from 2007 on, the code page that the file names before."""
    from ezdxf.tools.codepage import toencoding

    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError:
        page = re.search(rb"\$DWGCODEPAGE\s+3\s+(\w+)", content[:100_000])
        encoding = toencoding(page.group(1).decode("ascii")) if page else "cp1252"
        text = content.decode(encoding, errors="replace")
    return text.replace("\r\n", "\n").replace("\r", "\n")


def _from_binary(content: bytes) -> str:
    """A binary DXF file as the text of an ASCII one, with all digits of its numbers."""
    import ezdxf
    from ezdxf.lldxf.tagger import binary_tags_loader

    lines: list[str] = []
    try:
        for code, value in binary_tags_loader(content, errors="replace"):
            lines.append(str(code))
            lines.append(value.hex().upper() if isinstance(value, bytes) else str(value))
    except (ezdxf.DXFError, IndexError, ValueError, struct.error) as error:
        raise GeometryError(f"the binary DXF file is damaged ({error}); export it again") from error
    return "\n".join(lines) + "\n"


def _marked(text: str) -> tuple[str, Counter[str]]:
    """The file with the subclass markers that entities of :data:`MARKERS` miss, and how many of which kind did."""
    lines = text.split("\n")
    if len(lines) % 2:
        lines.pop()  # what follows the last line end
    added: Counter[str] = Counter()
    entity: list[tuple[str, str]] = []
    result: list[str] = []
    for code, value in [*zip(lines[::2], lines[1::2], strict=False), ("0", "")]:
        if code.strip() == "0":
            for tag in _with_marker(entity, added):
                result += tag
            entity = []
        entity.append((code.strip(), value))
    return "\n".join(result) + "\n", added


def _with_marker(entity: list[tuple[str, str]], added: Counter[str]) -> list[tuple[str, str]]:
    """The tags of one entity, sorted under the markers of its kind where it has not got them."""
    kind = entity[0][1].strip() if entity else ""
    if kind not in MARKERS or ("100", MARKERS[kind]) in ((c, v.strip()) for c, v in entity):
        return entity
    added[kind] += 1
    tags = [tag for tag in entity[1:] if tag[0] != "100"]
    own = next((k for k, (code, _) in enumerate(tags) if code not in _BASE | _COMMON), len(tags))
    head, tail = tags[:own], tags[own:]
    return [
        entity[0],
        *(tag for tag in head if tag[0] in _BASE),
        ("100", "AcDbEntity"),
        *(tag for tag in (*head, *tail) if tag[0] in _COMMON),
        ("100", MARKERS[kind]),
        *(tag for tag in tail if tag[0] not in _COMMON),
    ]


@contextmanager
def quiet() -> Iterator[None]:
    """Keep the log of ezdxf off the screen: what matters of it is noted."""
    logger = logging.getLogger("ezdxf")
    level = logger.level
    logger.setLevel(logging.CRITICAL)
    try:
        yield
    finally:
        logger.setLevel(level)
