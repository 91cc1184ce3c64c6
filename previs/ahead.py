"""Work beside the drawing: voxels of the next time are read and packed, and pictures written, by other threads.

USD is asked by the calling thread only: which files a time takes is a cheap question, and a stage must not be read by
two threads while one edits it. Reading files, unpacking and packing touch no stage and no OpenGL.
"""

from __future__ import annotations

import threading
import time as clock
from collections.abc import Callable, Iterable

import numpy as np

from .description import Field, SceneDescription
from .errors import PrevisError
from .render.renderer import Renderer
from .settings import Settings
from .stage import StageReader
from .stage.field import GridRequest


def fetch_and_pack(
    reader: StageReader,
    requests: Iterable[GridRequest],
    renderer: Renderer,
    settings: Settings,
    stopped: Callable[[], bool] = lambda: False,
) -> int:
    """Read the grids of a time and pack them for a renderer, from any thread; returns the bytes of what was read.

    What cannot be read ends it without a word: the reading of that time will say it.
    """
    read = 0
    for request in requests:
        if stopped():
            break
        try:
            loaded = reader.fetch(request)
            if not stopped():
                # Where the grid lies in its volume does not matter to what is packed.
                renderer.prepare_field(Field(loaded.key, loaded.grid, np.eye(4)), settings, request.field)
        except (PrevisError, MemoryError):
            break
        read += loaded.nbytes
    return read


class ReadAhead:
    """Reads the voxels of one time in a thread. Use it as a context manager.

    At most one time is read ahead: `begin` waits for the one before.

    Args:
        reader: of the stage.
        renderer: what is packed is for it.
    """

    def __init__(self, reader: StageReader, renderer: Renderer) -> None:
        self._reader, self._renderer = reader, renderer
        self._stop = threading.Event()
        self._thread: threading.Thread | None = None

    def __enter__(self) -> ReadAhead:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def begin(self, following: float, present: SceneDescription, settings: Settings) -> None:
        """Start to read what the picture at the following time code takes from files.

        What the present picture takes is packed before, and what others took is let go: no more than the voxels of
        two times are held packed.

        Args:
            following: the time code to read.
            present: the scene that is drawn meanwhile.
            settings: the knobs that both are drawn with.
        """
        self.wait()
        try:
            self._renderer.prepare(present, settings)
            requests = self._reader.grid_requests(following)
        except (PrevisError, MemoryError):
            # It will be said when it is drawn or read.
            return
        arguments = (self._reader, requests, self._renderer, settings, self._stop.is_set)
        # A daemon: who gives up does not wait for a file to be read to its end.
        self._thread = threading.Thread(target=fetch_and_pack, args=arguments, name="previs reading", daemon=True)
        self._thread.start()

    def wait(self) -> None:
        """Wait for what is being read."""
        if self._thread is not None:
            self._thread.join()
            self._thread = None

    def close(self) -> None:
        """Stop at the next grid, without waiting for it."""
        self._stop.set()


class Writing:
    """A picture being written by a thread; the interpreter does not end before it is.

    Args:
        write: writes it.
    """

    def __init__(self, write: Callable[[], None]) -> None:
        self._write = write
        self._error: BaseException | None = None
        self._seconds = 0.0
        self._thread = threading.Thread(target=self._run, name="previs writing")
        self._thread.start()

    @property
    def done(self) -> bool:
        """Whether it was written, or failed."""
        return not self._thread.is_alive()

    def wait(self) -> float:
        """Wait for its end; returns the seconds that it took, and raises what writing it raised."""
        self._thread.join()
        if self._error is not None:
            raise self._error
        return self._seconds

    def _run(self) -> None:
        begin = clock.perf_counter()
        try:
            self._write()
        except BaseException as error:
            self._error = error
        self._seconds = clock.perf_counter() - begin
