"""Plays the timeline, and reads the next frames before they are needed."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor

from ..ahead import fetch_and_pack
from ..errors import PrevisError
from ..render.renderer import Renderer
from .document import Document

#: Frames read ahead of the one shown, and the bytes of voxels that they may take: well below what the caches of the
#: reader and the renderer hold, or the last of them would push out the first.
AHEAD = 6
MEMORY = 2**29


class Playback:
    """Advances the time of a document and prefetches the voxels of the frames to come.

    USD is asked by the calling thread only; a thread reads the files and packs the voxels.

    Args:
        document: what is played.
        renderer: the renderer whose packed voxels the frames take.
    """

    def __init__(self, document: Document, renderer: Renderer) -> None:
        self._document = document
        self._renderer = renderer
        self._pool = ThreadPoolExecutor(1, thread_name_prefix="previs prefetch")
        self._stop = threading.Event()
        self._jobs: dict[float, Future[int]] = {}
        self._due: float | None = None

    @property
    def prefetched(self) -> frozenset[float]:
        """The next times whose voxels were read ahead."""
        return frozenset(t for t, job in self._jobs.items() if job.done())

    def ready(self, time: float) -> bool:
        """Whether there is nothing to wait for: a time was read ahead, or cannot be."""
        job = self._jobs.get(time)
        if job is not None and job.done():
            return True
        reader = self._document.scene.reader
        try:
            return all(reader.is_fetched(r) for r in reader.grid_requests(time))
        except PrevisError:
            return True

    def advance(self, now: float, frames_per_second: float) -> float | None:
        """The time to show now, or None to stay where it is.

        A frame that is due but not read yet is waited for; frames that there is no time for are skipped.

        Args:
            now: seconds of a steady clock.
            frames_per_second: speed of the clock of the stage.
        """
        document = self._document
        if document.time_range is None:
            return None
        interval = 1.0 / max(frames_per_second, 1e-3)
        if self._due is None:
            self._due = now + interval
            self.prefetch()
            return None
        if now < self._due:
            return None
        steps = 1 + int((now - self._due) / interval)
        following = self._after(document.time, steps)
        if not self.ready(following):
            following = self._after(document.time, 1)
            if not self.ready(following):
                self.prefetch()
                # The clock waits too, or what comes after would be skipped for it.
                self._due = now
                return None
        self._due = max(self._due + steps * interval, now)
        return following

    def pause(self) -> None:
        """Forget when the next frame was due."""
        self._due = None

    def _after(self, time: float, steps: int) -> float:
        span = self._document.time_range
        assert span is not None
        return span.after(time, steps)

    def _upcoming(self) -> Iterator[float]:
        for steps in range(1, AHEAD + 1):
            yield self._after(self._document.time, steps)

    def prefetch(self) -> None:
        """Start reading the frames to come that nobody reads yet."""
        document = self._document
        if document.time_range is None:
            return
        wanted = list(dict.fromkeys(self._upcoming()))
        for time in [t for t in self._jobs if t not in wanted and self._jobs[t].done()]:
            del self._jobs[time]
        reader, settings = document.scene.reader, document.settings
        largest = max((job.result() for job in self._jobs.values() if job.done()), default=0)
        for time in wanted[: max(int(MEMORY / max(largest, 1)), 1)]:
            if time in self._jobs:
                continue
            try:
                requests = reader.grid_requests(time)
            except PrevisError:
                # It will be said when the frame is shown.
                continue
            self._jobs[time] = self._pool.submit(
                fetch_and_pack, reader, requests, self._renderer, settings, self._stop.is_set
            )

    def close(self) -> None:
        """End the thread; a file that it is just reading is read to its end, but nobody waits for it."""
        self._stop.set()
        self._pool.shutdown(wait=False, cancel_futures=True)
