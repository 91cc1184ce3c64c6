"""What a file browser needs to know of the disk: folders and files in order, paths as typed. No ImGui."""

from __future__ import annotations

import os
import re
from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class Listing:
    """A folder's content: folders, and files that fit, in reading order; `error` is why there is nothing."""

    folder: str
    folders: tuple[str, ...] = ()
    files: tuple[str, ...] = ()
    error: str = ""


def listing(folder: str, endings: tuple[str, ...] = (), hidden: bool = False) -> Listing:
    """Read a folder; files whose name has another ending are left out, and hidden ones unless asked for."""
    folders, files = [], []
    try:
        with os.scandir(folder) as entries:
            for entry in entries:
                if entry.name.startswith(".") and not hidden:
                    continue
                if _is_folder(entry):
                    folders.append(entry.name)
                elif fits(entry.name, endings):
                    files.append(entry.name)
    except OSError as error:
        return Listing(folder, error=f"{error.strerror or error}")
    return Listing(folder, tuple(sorted(folders, key=reading_order)), tuple(sorted(files, key=reading_order)))


def _is_folder(entry: os.DirEntry[str]) -> bool:
    try:
        return entry.is_dir()
    except OSError:
        return False


def fits(name: str, endings: tuple[str, ...]) -> bool:
    """Whether a file name has one of the endings; without endings all fit."""
    return not endings or name.lower().endswith(endings)


def reading_order(name: str) -> tuple[tuple[int, int, str], ...]:
    """A key that sorts frame9 before frame10, and capitals with small letters."""
    parts = re.split(r"(\d+)", name.lower())
    return tuple((0, int(part), "") if part.isdigit() else (1, 0, part) for part in parts)


def typed_path(text: str, folder: str) -> str:
    """The absolute path of what was typed: ~ and variables are expanded, a relative path starts at the folder."""
    expanded = os.path.expandvars(os.path.expanduser(text.strip()))
    return os.path.normpath(os.path.join(folder, expanded))


def with_ending(path: str, endings: tuple[str, ...]) -> str:
    """The path with the first of the endings where it has none of them."""
    return path if fits(path, endings) else path + endings[0]


def nearest_folder(path: str) -> str:
    """The path itself, or the folder above it that exists."""
    place = Path(os.path.abspath(path))
    for candidate in (place, *place.parents):
        if candidate.is_dir():
            return str(candidate)
    return os.getcwd()
