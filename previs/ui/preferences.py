"""What the application remembers of its user from one session to the next, in one JSON file.

The file is `preferences.json` in the user's configuration folder (see `config_folder`), next to the window's layout and
the recovery files. It holds only what differs from the defaults. Several processes may share it: saving changes the
values that this process changed and leaves those that another one wrote meanwhile; a value of a newer version of
previs stays too.

Preferences are never a reason not to start: a file that cannot be understood is set aside under another name, a value
of the wrong type is replaced by its default, and `problem` says so in one line.
"""

from __future__ import annotations

import json
import os
import sys
import tempfile
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any

from ..errors import PrevisError

FILE_NAME = "preferences.json"
LAYOUT_NAME = "layout.ini"
RECENT_FILES = 12


def config_folder(environment: Mapping[str, str] = os.environ, platform: str = sys.platform) -> Path:
    """The folder of everything that previs remembers; it need not exist.

    `PREVIS_CONFIG` names it; else it is `previs` in ``%APPDATA%`` (Windows), ``~/Library/Application Support`` (macOS),
    ``$XDG_CONFIG_HOME`` or ``~/.config`` (elsewhere).
    """
    if environment.get("PREVIS_CONFIG"):
        return Path(environment["PREVIS_CONFIG"]).expanduser().absolute()
    if platform == "win32":
        base = environment.get("APPDATA") or Path.home() / "AppData" / "Roaming"
    elif platform == "darwin":
        base = Path.home() / "Library" / "Application Support"
    else:
        base = environment.get("XDG_CONFIG_HOME", "")
        # The specification wants relative paths to be ignored.
        if not os.path.isabs(base):
            base = Path.home() / ".config"
    return Path(base) / "previs"


def write_atomically(path: Path, text: str) -> None:
    """Write a text file so that a reader, or a crash, finds either the old content or the new, whole. Raises OSError.

    The folder is made where it is missing.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    handle, name = tempfile.mkstemp(prefix=f"{path.name}.", suffix=".part", dir=path.parent)
    try:
        with os.fdopen(handle, "w", encoding="utf-8") as file:
            file.write(text)
        os.replace(name, path)
    except BaseException:
        with suppress(OSError):
            os.unlink(name)
        raise


def set_aside(path: Path) -> Path:
    """Rename a file that cannot be used to ``<name>.damaged``, with a number where that exists; returns the new path.

    Raises OSError when that is not possible.
    """
    aside = path.with_name(path.name + ".damaged")
    number = 1
    while aside.exists():
        number += 1
        aside = path.with_name(f"{path.name}.damaged{number}")
    return path.rename(aside)


@dataclass
class Preferences:
    """The values, free to be changed; `save` writes them.

    Attributes:
        recent: absolute paths, the latest first, RECENT_FILES at most; see `add_recent`.
        color_correction: "disabled", "sRGB" or "openColorIO".
        ocio_display, ocio_view: names of OpenColorIO, "" for the configuration's defaults.
        gate_mask: whether what lies outside a camera's aperture is darkened.
        measure_error: whether the error of a picture at rest is measured.
        converge: whether a picture at rest goes on to the truth.
        folder: where the file is.
        problem: one line about what could not be read, "" when all is well.
    """

    recent: list[str] = field(default_factory=list)
    color_correction: str = "sRGB"
    ocio_display: str = ""
    ocio_view: str = ""
    gate_mask: bool = True
    measure_error: bool = True
    converge: bool = False
    folder: Path = field(default_factory=config_folder)
    problem: str = ""

    def __post_init__(self) -> None:
        self._saved = self._values()

    @classmethod
    def load(cls, folder: Path | None = None) -> Preferences:
        """Read the file; the defaults where there is none. `folder` is `config_folder()` by default."""
        preferences = cls(folder=config_folder() if folder is None else Path(folder))
        stored, preferences.problem = _read(preferences.path)
        usable = {name: value for name, value in stored.items() if _fits(name, value)}
        wrong = sorted(set(stored) & set(_DEFAULTS) - set(usable))
        if wrong:
            preferences.problem = f"{preferences.path}: no usable value for {', '.join(wrong)}; the default is used"
        preferences._take(usable)
        return preferences

    @property
    def path(self) -> Path:
        """Of the JSON file."""
        return self.folder / FILE_NAME

    @property
    def layout_path(self) -> Path:
        """Of the window's layout: an ini file that the window toolkit reads and writes."""
        return self.folder / LAYOUT_NAME

    def save(self) -> None:
        """Write what was changed since the last `load` or `save`; nothing is written where nothing was.

        Raises PrevisError when the file cannot be written.
        """
        values = self._values()
        changed = {name for name, value in values.items() if value != self._saved[name]}
        if not changed:
            return
        stored, problem = _read(self.path)
        self.problem = problem or self.problem
        merged = stored | {name: values[name] for name in changed}
        if "recent" in changed and _fits("recent", stored.get("recent")):
            # Files that another process opened meanwhile; not those that this one has just forgotten.
            others = [f for f in stored["recent"] if f not in self._saved["recent"]]
            merged["recent"] = list(dict.fromkeys(values["recent"] + others))[:RECENT_FILES]
        # What is not ours to judge stays, what cannot be used goes, and defaults need not be written.
        merged = {
            name: value
            for name, value in merged.items()
            if name not in _DEFAULTS or (_fits(name, value) and value != _DEFAULTS[name])
        }
        try:
            write_atomically(self.path, json.dumps(merged, indent=2, sort_keys=True, ensure_ascii=False) + "\n")
        except OSError as error:
            raise PrevisError(f"{self.path}: preferences cannot be saved: {error.strerror or error}") from None
        self._take({name: value for name, value in merged.items() if _fits(name, value)})

    def add_recent(self, path: str | os.PathLike[str]) -> None:
        """Put a file first in the list."""
        absolute = os.path.abspath(path)
        self.recent = [absolute, *(f for f in self.recent if f != absolute)][:RECENT_FILES]

    def forget_recent(self, path: str | os.PathLike[str]) -> None:
        """Take a file out of the list, as when it no longer exists."""
        absolute = os.path.abspath(path)
        self.recent = [f for f in self.recent if f != absolute]

    def _values(self) -> dict[str, Any]:
        return {name: list(value) if isinstance(value := getattr(self, name), list) else value for name in _DEFAULTS}

    def _take(self, stored: Mapping[str, Any]) -> None:
        for name in _DEFAULTS:
            if name in stored:
                default, value = _DEFAULTS[name], stored[name]
                setattr(self, name, list(value) if isinstance(default, list) else type(default)(value))
        self._saved = self._values()


_DEFAULTS: dict[str, Any] = {
    f.name: [] if f.name == "recent" else f.default for f in fields(Preferences) if f.name not in ("folder", "problem")
}


def _fits(name: str, value: Any) -> bool:
    """Whether a stored value can stand for a preference."""
    default = _DEFAULTS.get(name, ...)
    if isinstance(default, list):
        return isinstance(value, list) and all(isinstance(v, str) for v in value)
    return type(value) is type(default)


def _read(path: Path) -> tuple[dict[str, Any], str]:
    """(values, problem) of the file; what is no JSON object is set aside."""
    try:
        text = path.read_text(encoding="utf-8")
    except FileNotFoundError:
        return {}, ""
    except OSError as error:
        return {}, f"{path}: preferences cannot be read: {error.strerror or error}; the defaults are used"
    except UnicodeDecodeError:
        return {}, _damaged(path)
    try:
        values = json.loads(text)
    except (ValueError, RecursionError):
        return {}, _damaged(path)
    return (values, "") if isinstance(values, dict) else ({}, _damaged(path))


def _damaged(path: Path) -> str:
    try:
        aside = set_aside(path)
    except OSError as error:
        return f"{path}: damaged, and it cannot be renamed: {error.strerror or error}; the defaults are used"
    return f"{path}: damaged; it is now {aside.name}, and the defaults are used"
