"""Notices when files of the open stage change on disk."""

from __future__ import annotations

import os
from collections.abc import Iterable

#: A file must have rested this long, in seconds, before it is read again: writers take their time.
REST = 0.4
#: Seconds between two looks.
INTERVAL = 1.0

_State = tuple[int, int] | None


class FileWatch:
    """Compares modification time and size of files with those of the last look."""

    def __init__(self) -> None:
        self._known: dict[str, _State] = {}
        self._changed = False
        self._next = 0.0

    def watch(self, files: Iterable[str]) -> None:
        """Watch exactly these files, as they are now where they are new."""
        self._known = {f: self._known[f] if f in self._known else _state(f) for f in files}

    def accept(self, file: str) -> None:
        """Take a file as it is now: its change is our own."""
        if file in self._known:
            self._known[file] = _state(file)

    def changed(self, now: float) -> bool:
        """Whether a file changed and has rested since; says so once per change.

        Args:
            now: seconds of any steady clock; most calls do nothing.
        """
        if now < self._next:
            return False
        self._next = now + INTERVAL
        states = {f: _state(f) for f in self._known}
        if states != self._known:
            self._known, self._changed = states, True
            self._next = now + REST
            return False
        rested, self._changed = self._changed, False
        return rested


def _state(file: str) -> _State:
    try:
        status = os.stat(file)
    except OSError:
        return None
    return status.st_mtime_ns, status.st_size
