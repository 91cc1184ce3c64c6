"""Edits that outlive a crash: what a session has not saved is on disk a few seconds later.

Every running application has at most one file in the recovery folder, `session-<process>-<token>.json`, and beside it a
lock file that it holds locked while it lives. The operating system releases the lock however the process ends, so a
file whose lock is free was left behind, and no process number that is used again can say otherwise. A clean exit
removes both.

Files are replaced atomically: a process that is killed while it writes leaves its previous state. They are not forced
to the disk, which could hold up the window for a moment; a power failure may cost the last seconds, or the entry.

    recovery = Recovery()
    for entry in recovery.pending():      # at the start: offer what was left behind
        state = recovery.take(entry)      # nobody else gets it now
        ...                               # open state.stage, restore state.snapshot
        recovery.forget(entry)            # once it is restored, or not wanted
    recovery.tick(state_function, now)    # every frame
    recovery.close()                      # at a clean exit
"""

from __future__ import annotations

import json
import os
import secrets
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any, NamedTuple

from ..errors import PrevisError
from .preferences import config_folder, set_aside, write_atomically

#: Seconds between two looks at whether something has changed.
INTERVAL = 4.0


class RecoveryState(NamedTuple):
    """What is worth keeping: the stage's path, its unsaved edits as text, and the view as JSON values.

    The path is stored as an absolute one; "" is a stage that was never on disk.
    """

    stage: str
    snapshot: str
    view: Mapping[str, Any]


@dataclass(frozen=True)
class Entry:
    """A session that was left behind, at the file `path`; `saved_at` is local time, the rest as in `RecoveryState`."""

    path: Path
    stage: str
    snapshot: str
    view: Mapping[str, Any]
    saved_at: datetime


class Recovery:
    """The recovery folder as one process sees it. `problem` is one line about the last thing that failed, or ""."""

    def __init__(self, folder: Path | None = None, interval: float = INTERVAL) -> None:
        """`folder` is `recovery` in the configuration folder by default; `interval` is in seconds."""
        self.folder = config_folder() / "recovery" if folder is None else Path(folder)
        self.interval = interval
        self.problem = ""
        self._path: Path | None = None
        self._lock: int | None = None
        self._written: RecoveryState | None = None
        self._next = -float("inf")
        self._claims: dict[Path, int] = {}

    # --- this session -----------------------------------------------------------------------------------------

    def tick(
        self,
        state_function: Callable[[], RecoveryState | tuple[str, str, Mapping[str, Any]] | None],
        now: float,
        force: bool = False,
    ) -> bool:
        """Save the state if it is time to and it has changed; True where something was written.

        Args:
            state_function: called every `interval` seconds at most. None means that nothing would be lost now, as
                after saving: the file of this session is removed.
            now: seconds of a clock that does not go back, such as `time.monotonic()`.
            force: do not wait for the interval.

        A failure to write is not raised: `problem` holds it until a write succeeds, and the next one is tried after
        the interval.
        """
        if now < self._next and not force:
            return False
        self._next = now + self.interval
        state = state_function()
        if state is None:
            self.discard()
            return False
        if state == self._written:
            return False
        stage, snapshot, view = state
        content = {
            "stage": os.path.abspath(stage) if stage else "",
            "snapshot": snapshot,
            "view": dict(view),
            "saved_at": time.time(),
        }
        text = json.dumps(content)
        try:
            write_atomically(self._own_path(), text)
        except OSError as error:
            self.problem = f"{self.folder}: edits cannot be kept for recovery: {error.strerror or error}"
            return False
        self.problem = ""
        self._written = state
        return True

    def discard(self) -> None:
        """Remove what this session has saved: nothing would be lost if it ended now."""
        self._written = None
        if self._path is not None:
            with suppress(OSError):
                self._path.unlink(missing_ok=True)

    def close(self) -> None:
        """A clean exit: this session leaves nothing. What it took and did not forget is offered again."""
        self.discard()
        if self._lock is not None:
            self._discard_lock(self._path, self._lock)
        self._path = self._lock = None
        for lock in self._claims.values():
            os.close(lock)
        self._claims.clear()

    def _own_path(self) -> Path:
        """The file of this session; the first call makes its lock. Raises OSError."""
        while self._path is None:
            path = self.folder / f"session-{os.getpid()}-{secrets.token_hex(4)}.json"
            self.folder.mkdir(parents=True, exist_ok=True)
            lock = _acquire(_lock_path(path), create=True)
            # A process that was tidying up may have seen the lock file before it was locked, and removed it.
            if lock is None:
                continue
            if _is_same_file(lock, _lock_path(path)):
                self._path, self._lock = path, lock
            else:
                os.close(lock)
        return self._path

    # --- what others left behind ------------------------------------------------------------------------------

    def pending(self) -> list[Entry]:
        """The sessions of processes that ended without `close`, the latest first.

        Also tidies up: remains of writes that were cut off go away, files that cannot be understood are renamed to
        ``.damaged``.
        """
        entries = []
        try:
            names = {path.name.partition(".")[0] for path in self.folder.glob("session-*.*")}
        except OSError as error:
            self.problem = f"{self.folder}: recovery files cannot be listed: {error.strerror or error}"
            return []
        for name in sorted(names):
            path = self.folder / f"{name}.json"
            if path == self._path or path in self._claims:
                continue
            try:
                entry = self._left_behind(path)
            except OSError as error:
                self.problem = f"{path}: recovery file cannot be used: {error.strerror or error}"
                continue
            if entry is not None:
                entries.append(entry)
        return sorted(entries, key=lambda e: e.saved_at, reverse=True)

    def take(self, entry: Entry) -> RecoveryState:
        """What an entry holds; until it is forgotten, or this process ends, nobody else is offered it.

        Raises PrevisError when another process has taken or removed it meanwhile.
        """
        try:
            if entry.path not in self._claims:
                lock = _acquire(_lock_path(entry.path), create=entry.path.exists())
                if lock is None:
                    raise PrevisError(f"{entry.path}: this session has been taken by another process")
                self._claims[entry.path] = lock
            state, _ = _read(entry.path)
        except (OSError, ValueError) as error:
            self._release(entry.path)
            raise PrevisError(f"{entry.path}: this session cannot be recovered: {error}") from None
        return state

    def forget(self, entry: Entry) -> None:
        """Remove an entry for good. Raises PrevisError when it belongs to another process now."""
        if entry.path not in self._claims:
            if not entry.path.exists():
                return
            lock = _acquire(_lock_path(entry.path), create=True)
            if lock is None:
                raise PrevisError(f"{entry.path}: this session has been taken by another process")
            self._claims[entry.path] = lock
        try:
            entry.path.unlink(missing_ok=True)
        except OSError as error:
            self._release(entry.path)
            raise PrevisError(f"{entry.path}: cannot be removed: {error.strerror or error}") from None
        self._discard_lock(entry.path, self._claims.pop(entry.path))

    def _left_behind(self, path: Path) -> Entry | None:
        """The entry of a file, None where its process lives or left nothing. Raises OSError."""
        lock = _acquire(_lock_path(path), create=path.exists())
        if lock is None:
            return None
        keep = False
        try:
            for part in self.folder.glob(f"{path.name}.*.part"):
                part.unlink(missing_ok=True)
            if not path.exists():
                return None
            try:
                state, saved_at = _read(path)
            except ValueError:
                aside = set_aside(path)
                self.problem = f"{path}: damaged recovery file; it is now {aside.name}"
                return None
            keep = True
            return Entry(path, *state, saved_at)
        finally:
            if keep:
                os.close(lock)
            else:
                self._discard_lock(path, lock)

    def _release(self, path: Path) -> None:
        lock = self._claims.pop(path, None)
        if lock is not None:
            os.close(lock)

    @staticmethod
    def _discard_lock(path: Path, lock: int) -> None:
        # Removed while still locked, so that nobody locks a file that is about to vanish; Windows wants it closed.
        with suppress(OSError):
            _lock_path(path).unlink(missing_ok=True)
        os.close(lock)
        if os.name == "nt":
            with suppress(OSError):
                _lock_path(path).unlink(missing_ok=True)


def _read(path: Path) -> tuple[RecoveryState, datetime]:
    """(state, local time of saving) of a file. Raises OSError, and ValueError for anything but a recovery file."""
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except RecursionError:
        raise ValueError("it is no recovery file") from None
    values = [content.get(k) for k in ("stage", "snapshot", "view", "saved_at")] if isinstance(content, dict) else []
    if not values or not all(isinstance(v, t) for v, t in zip(values, (str, str, dict, float), strict=True)):
        raise ValueError("it is no recovery file")
    try:
        return RecoveryState(*values[:3]), datetime.fromtimestamp(values[3])
    except (OverflowError, OSError):
        raise ValueError("it is no recovery file") from None


def _lock_path(path: Path) -> Path:
    return path.with_suffix(".lock")


def _acquire(path: Path, create: bool) -> int | None:
    """Lock a file and return its descriptor, None where another process has it or, without `create`, it is missing.

    Raises OSError where the file system has no locks.
    """
    try:
        handle = os.open(path, os.O_RDWR | (os.O_CREAT if create else 0), 0o600)
    except FileNotFoundError:
        if create:
            raise
        return None
    try:
        _try_lock(handle)
    except BlockingIOError:
        os.close(handle)
        return None
    except BaseException:
        os.close(handle)
        raise
    return handle


def _try_lock(handle: int) -> None:
    """Lock an open file; BlockingIOError where somebody else holds it."""
    if os.name == "nt":
        import msvcrt

        try:
            msvcrt.locking(handle, msvcrt.LK_NBLCK, 1)
        except OSError as error:
            raise BlockingIOError(error.errno, error.strerror) from None
    else:
        import fcntl

        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)


def _is_same_file(handle: int, path: Path) -> bool:
    try:
        return os.path.samestat(os.fstat(handle), os.stat(path))
    except FileNotFoundError:
        return False
