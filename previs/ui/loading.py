"""Opening stages without stopping the window: a thread reads and packs, the window shows how far it came."""

from __future__ import annotations

import os
import threading
import traceback
from collections.abc import Callable
from typing import Any

from ..errors import PrevisError
from ..render.renderer import Renderer
from ..scene import Scene
from .document import Document


class _Cancelled(Exception):
    """Raised inside the reading to end it."""


class Loading:
    """A stage being opened in a thread of its own.

    The thread opens the stage, reads it and packs its voxels; nobody else touches the scene until it is done.

    Args:
        path: what to open.
        prepare: packs the voxels of a document for the renderer; called in the thread with a progress function.
        options: keyword arguments of `Scene.open`.

    Attributes:
        progress: the done part in [0, 1]; `label` says what is being done.
        document: the result, when `done`; None when it was cancelled or nothing could be opened.
        error: why it could not be opened, or what had to be left out.
    """

    def __init__(
        self,
        path: str | os.PathLike[str],
        prepare: Callable[[Document, Callable[[float], None]], None],
        time: float | None = None,
        **options: Any,
    ) -> None:
        self.path = os.fspath(path)
        self.progress = 0.0
        self.label = "Opening"
        self.error = ""
        self.document: Document | None = None
        self._prepare, self._time, self._options = prepare, time, options
        self._stop = threading.Event()
        self._handing_over = threading.Lock()
        self._thread = threading.Thread(target=self._run, name="previs loading", daemon=True)
        self._thread.start()

    @property
    def done(self) -> bool:
        """Whether the thread has ended."""
        return not self._thread.is_alive()

    @property
    def cancelled(self) -> bool:
        """Whether `cancel` was called."""
        return self._stop.is_set()

    def cancel(self) -> None:
        """Ask the thread to end; it does at the next prim or field. A document that is there is closed."""
        with self._handing_over:
            self._stop.set()
            document, self.document = self.document, None
        if document is not None:
            document.close()

    def wait(self, seconds: float | None = None) -> None:
        """Wait until the thread has ended."""
        self._thread.join(seconds)

    def _run(self) -> None:
        try:
            try:
                document = self._open(self._options)
            except PrevisError as error:
                # What cannot be read is left out, so that the rest can be seen and mended.
                self.error = str(error)
                document = self._open({**self._options, "keep_going": True})
        except _Cancelled:
            self.error = ""
        except PrevisError as error:
            self.error = str(error)
        except MemoryError:
            self.error = f"{self.path}: there is not enough memory to read it"
        except Exception as error:
            # The thread's end is all that others see: it must not be one without a reason.
            traceback.print_exc()
            self.error = f"{self.path}: previs made an error: {type(error).__name__}: {error}"
        else:
            with self._handing_over:
                if not self._stop.is_set():
                    self.document = document
                    return
            self.error = ""
            document.close()

    def _open(self, options: dict[str, Any]) -> Document:
        scene = Scene.open(self.path, **options)
        try:
            document = Document(scene, self.path, self._time, progress=self._reading)
            self.label = "Packing voxels"
            self._prepare(document, lambda fraction: self._report(0.7 + 0.3 * fraction))
            self._report(1.0)
        except BaseException:
            scene.close()
            raise
        return document

    def _reading(self, fraction: float, prim: str) -> None:
        self.label = f"Reading {prim}"
        self._report(0.7 * fraction)

    def _report(self, fraction: float) -> None:
        if self._stop.is_set():
            raise _Cancelled
        self.progress = fraction


def packer(renderer: Renderer) -> Callable[[Document, Callable[[float], None]], None]:
    """What `Loading` needs to pack a document's voxels for a renderer."""

    def prepare(document: Document, progress: Callable[[float], None]) -> None:
        renderer.prepare(document.description, document.settings, progress)

    return prepare
