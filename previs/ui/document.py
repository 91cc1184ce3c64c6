"""An open stage with its edits, their history, and the last description of it that was good.

Every edit authors USD through `Scene`, on the session layer of an opened stage. Undo puts back what the edits had
authored before, as text; the reader finds out what changed and the index which parts moved, so undoing an albedo
costs what setting it costs.
"""

from __future__ import annotations

import itertools
import os
import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace

from ..description import SceneDescription
from ..errors import PrevisError
from ..scene import Scene
from ..settings import Settings

#: Undo entries kept.
HISTORY_LIMIT = 500

_versions = itertools.count(1)


@dataclass(frozen=True, eq=False)
class Look:
    """What there was to be seen at one moment."""

    description: SceneDescription
    settings: Settings


@dataclass(frozen=True)
class _Entry:
    label: str
    before: str
    after: str


@dataclass(frozen=True, eq=False)
class _Past:
    """A look, the edits that gave it, and what it was read from besides: time code and state of the files."""

    look: Look
    snapshot: str
    read_from: tuple[float | None, int]


class Document:
    """One scene being looked at and tuned. No OpenGL, no ImGui.

    Args:
        scene: the scene, which the document owns from now on.
        path: what was opened, for the user to read.
        time: time code shown; None is the earliest of the stage.
        progress: called with the part that is read, in [0, 1], and the prim being read; it may raise to stop.

    Raises:
        PrevisError: when the scene cannot be described.

    Attributes:
        description: the last description that could be read.
        settings: the knobs: what the stage says, edits included.
        error: why the stage as it is now cannot be shown; "" when `description` is what the stage holds.
        version: moves when description or settings did.
    """

    def __init__(
        self,
        scene: Scene,
        path: str | os.PathLike[str],
        time: float | None = None,
        progress: Callable[[float, str], None] | None = None,
    ) -> None:
        self.scene = scene
        self.path = os.fspath(path)
        self.time_range = scene.time_range
        self.time: float = time if time is not None else (self.time_range.start if self.time_range else 0.0)
        self.description: SceneDescription = scene.describe(self.time_code, progress=progress)
        self.settings = Settings(**scene.settings())
        self.error = ""
        self.version = next(_versions)
        self._undone: list[_Entry] = []
        self._done: list[_Entry] = []
        self._group: tuple[str, _Past] | None = None
        self._reloads = 0
        self._past = self._present()
        self._saved = self._past.snapshot

    @property
    def _read_from(self) -> tuple[float | None, int]:
        return self.time_code, self._reloads

    def _present(self) -> _Past:
        return _Past(Look(self.description, self.settings), self.scene.snapshot(), self._read_from)

    @property
    def before(self) -> Look:
        """What was to be seen before the last edit, at the time shown now and from the files as they are now."""
        past = self._past
        if past.read_from != self._read_from:
            self._past = replace(past, look=self._look_with(past.snapshot) or past.look, read_from=self._read_from)
        return self._past.look

    def _look_with(self, edits: str) -> Look | None:
        """What there is to be seen with other edits; None where that cannot be read."""
        present = self.scene.snapshot()
        try:
            self.scene.restore(edits)
            return Look(self.scene.describe(self.time_code), Settings(**self.scene.settings()))
        except PrevisError:
            return None
        finally:
            self.scene.restore(present)
            if not self.error:
                # The same again, which is nothing new to anybody.
                with suppress(PrevisError):
                    self.description = self.scene.describe(self.time_code)

    @property
    def name(self) -> str:
        """The file's name."""
        return os.path.basename(self.path)

    @property
    def animated(self) -> bool:
        """Whether the stage has a range of time."""
        return self.time_range is not None

    @property
    def modified(self) -> bool:
        """Whether there are edits that were not saved."""
        return self.scene.snapshot() != self._saved

    # --- edits ----------------------------------------------------------------------------------------------------

    def edit(self, label: str, change: Callable[[Scene], None]) -> None:
        """Change the scene; an entry of the history of its own, unless `begin` opened one.

        Raises:
            PrevisError: when the change is refused; the scene is then as before.
        """
        present = self._present()
        try:
            change(self.scene)
        except Exception as error:
            self.scene.restore(present.snapshot)
            if isinstance(error, ValueError):
                raise PrevisError(str(error)) from error
            raise
        if self._group is None:
            self._remember(label, present)
        else:
            self._past = self._group[1]
        self.refresh()

    def begin(self, label: str) -> None:
        """Open an entry of the history that all edits up to `end` belong to, such as those of one drag."""
        self.end()
        self._group = (label, self._present())

    def end(self) -> None:
        """Close the entry; without an edit since `begin` there is none."""
        if self._group is not None:
            group, self._group = self._group, None
            self._remember(*group)

    @contextmanager
    def _outside_group(self) -> Iterator[None]:
        """Close the entry for something that is none of its edits; those that follow belong to another of its name."""
        group = self._group
        self.end()
        try:
            yield
        finally:
            if group is not None:
                self.begin(group[0])

    def _remember(self, label: str, past: _Past) -> None:
        after = self.scene.snapshot()
        if after == past.snapshot:
            return
        self._past = past
        self._done.append(_Entry(label, past.snapshot, after))
        del self._done[:-HISTORY_LIMIT]
        self._undone.clear()

    @property
    def undo_label(self) -> str:
        """What `undo` would take back, "" for nothing."""
        return self._done[-1].label if self._done else ""

    @property
    def redo_label(self) -> str:
        """What `redo` would do again, "" for nothing."""
        return self._undone[-1].label if self._undone else ""

    def undo(self) -> str:
        """Take back the last edit; returns its label, "" when there was none."""
        with self._outside_group():
            if not self._done:
                return ""
            entry = self._done.pop()
            self._undone.append(entry)
            self._restore(entry.before)
            return entry.label

    def redo(self) -> str:
        """Do the last undone edit again; returns its label, "" when there was none."""
        with self._outside_group():
            if not self._undone:
                return ""
            entry = self._undone.pop()
            self._done.append(entry)
            self._restore(entry.after)
            return entry.label

    def _restore(self, snapshot: str) -> None:
        self._past = self._present()
        self.scene.restore(snapshot)
        self.refresh()

    def discard(self) -> None:
        """Take all edits back, as one entry of the history."""
        with self._outside_group():
            self.edit("Discard overrides", lambda scene: scene.discard_overrides())

    def restore_edits(self, snapshot: str, label: str = "Recover edits") -> None:
        """Put edits from elsewhere in the place of the present ones, as one entry of the history.

        Raises:
            PrevisError: when they are not USD.
        """
        with self._outside_group():
            self.edit(label, lambda scene: scene.restore(snapshot))

    # --- time -----------------------------------------------------------------------------------------------------

    @property
    def time_code(self) -> float | None:
        """The time shown as the scene takes it: None where the stage has no range of time."""
        return self.time if self.time_range is not None else None

    def set_time(self, time: float) -> None:
        """Show another time code."""
        if time != self.time:
            self.time = time
            self.refresh()

    # --- files ----------------------------------------------------------------------------------------------------

    def refresh(self) -> None:
        """Read what changed. What cannot be read leaves the last good description and says so in `error`.

        That holds for errors of previs too, which go to stderr: a file that nobody thought of must not cost the edits.
        """
        try:
            description, settings = self.scene.describe(self.time_code), Settings(**self.scene.settings())
        except PrevisError as error:
            self.error = str(error)
            return
        except Exception as error:
            text = f"previs made an error in reading the stage: {type(error).__name__}: {error}"
            if text != self.error:
                traceback.print_exc()
            self.error = text
            return
        self.error = ""
        if description is not self.description or settings != self.settings:
            self.description, self.settings = description, settings
            self.version = next(_versions)

    def save_overrides(self, path: str | os.PathLike[str]) -> None:
        """Write the edits as a layer that goes over the stage.

        Raises:
            PrevisError: when it cannot be written.
        """
        try:
            self.scene.save_overrides(path)
        except ValueError as error:
            raise PrevisError(str(error)) from error
        self._saved = self.scene.snapshot()

    def reload(self) -> None:
        """Read again what changed on disk; the edits stay."""
        self._reloads += 1
        unreadable = ""
        try:
            self.scene.reload()
        except PrevisError as error:
            unreadable = str(error)
        self.time_range = self.scene.time_range
        # The other files were read all the same.
        self.refresh()
        self.error = unreadable or self.error

    def close(self) -> None:
        """Release the scene."""
        self.scene.close()
