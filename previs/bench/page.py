"""The page of a bench: one HTML file with everything in it."""

from __future__ import annotations

import base64
import html
from collections.abc import Mapping, Sequence
from typing import Any

from .tables import Table

_STYLE = """
body { font: 16px/1.5 system-ui, sans-serif; color: #1c1c1c; background: #fff; max-width: 1180px;
  margin: 2em auto; padding: 0 1.2em; }
h1 { font-size: 1.7em; margin-bottom: .2em; }
h2 { font-size: 1.3em; margin-top: 2.2em; border-bottom: 1px solid #ccc; }
h3 { font-size: 1.05em; margin-top: 1.6em; }
p, li { max-width: 52em; }
figure { margin: 1em 0; }
img { max-width: 100%; height: auto; }
figcaption { color: #444; font-size: .92em; max-width: 60em; }
.t { overflow-x: auto; }
table { border-collapse: collapse; font-size: .88em; font-variant-numeric: tabular-nums; }
th, td { padding: .18em .7em; border-bottom: 1px solid #e2e2e2; white-space: nowrap; }
th { background: #f3f3f3; }
.w { text-align: left; }
.n { text-align: right; }
tr.m td { background: #fff6d9; }
details { margin: .6em 0; }
summary { cursor: pointer; }
"""


def paragraph(text: str) -> str:
    """A paragraph of plain text."""
    return f"<p>{html.escape(text)}</p>\n"


def bullets(items: Sequence[str]) -> str:
    """A list of plain sentences."""
    return "<ul>\n" + "".join(f"<li>{html.escape(item)}</li>\n" for item in items) + "</ul>\n"


def picture(data: bytes, kind: str, caption: str) -> str:
    """A picture embedded in the page; `kind` is jpeg or png."""
    source = f"data:image/{kind};base64,{base64.b64encode(data).decode('ascii')}"
    text = html.escape(caption)
    return f'<figure><img src="{source}" alt="{text}"><figcaption>{text}</figcaption></figure>\n'


def folded(title: str, content: str) -> str:
    """Content that is shown when its title is clicked."""
    return f"<details><summary>{html.escape(title)}</summary>\n{content}</details>\n"


def section(title: str, *content: str) -> str:
    """A chapter of the page; content is HTML."""
    return f"<section>\n<h2>{html.escape(title)}</h2>\n{''.join(content)}</section>\n"


def page(title: str, lead: str, sections: Sequence[str]) -> str:
    """The whole page. It refers to nothing outside itself."""
    name = html.escape(title)
    return (
        '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<title>{name}</title>\n<style>{_STYLE}</style>\n</head>\n<body>\n<h1>{name}</h1>\n"
        f"{paragraph(lead)}{''.join(sections)}</body>\n</html>\n"
    )


def machine_table(machine: Mapping[str, Any], version: str, date: str) -> Table:
    """What the bench ran on."""
    rows = (
        ("previs", version),
        ("date", date),
        ("system", machine["system"]),
        ("processor", f"{machine['processor']}, {machine['processors']} processors"),
        ("OpenGL", machine["device"] + (" (software rasteriser)" if machine["software"] else "")),
        ("time is", machine["clock"]),
    )
    return Table("Machine", ("", ""), rows, names=2)
