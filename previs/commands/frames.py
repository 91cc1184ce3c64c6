"""Frame specifications and numbered file names, as usdrecord understands them."""

from __future__ import annotations

import re
from pathlib import Path

_RANGE = re.compile(r"^(?P<first>-?\d+(?:\.\d+)?)(?::(?P<last>-?\d+(?:\.\d+)?)(?:x(?P<step>\d+(?:\.\d+)?))?)?$")
_PLACEHOLDER = re.compile(r"#+(?:\.#+)?")


def parse_frames(text: str) -> list[float]:
    """Time codes of a specification like ``1:100x2,120`` (first:last, x stride; last is included; 10:1 counts down).

    Raises:
        ValueError: with a sentence, for anything else.
    """
    frames: list[float] = []
    for part in text.split(","):
        match = _RANGE.match(part.strip())
        if match is None:
            raise ValueError(f"frames {part!r}: write FIRST, FIRST:LAST or FIRST:LASTxSTRIDE, separated by commas")
        first = float(match["first"])
        last = float(match["last"]) if match["last"] is not None else first
        step = float(match["step"]) if match["step"] is not None else 1.0
        if step <= 0.0:
            raise ValueError(f"frames {part!r}: the stride must be more than 0")
        count = int(abs(last - first) / step + 1e-9) + 1
        if count > 1_000_000:
            raise ValueError(f"frames {part!r}: that is {count} frames")
        sign = 1.0 if last >= first else -1.0
        frames += [first + sign * step * i for i in range(count)]
    return list(dict.fromkeys(frames))


def has_placeholder(path: str) -> bool:
    """Whether a file name has a place for the frame number: ``###`` or ``###.###``."""
    return _PLACEHOLDER.search(Path(path).name) is not None


def frame_path(path: str, frame: float) -> str:
    """The file of a frame: ``###`` in the name becomes the number, padded to as many digits; ``###.###`` keeps
    decimals."""
    name = Path(path).name
    match = _PLACEHOLDER.search(name)
    if match is None:
        return path
    whole, _, decimals = match[0].partition(".")
    if decimals:
        number = f"{frame:0{len(whole) + 1 + len(decimals)}.{len(decimals)}f}"
    else:
        number = f"{round(frame):0{len(whole)}d}"
    return str(Path(path).with_name(name[: match.start()] + number + name[match.end() :]))
