"""What follows from the versions of parts of a scene, kept from plan to plan."""

from __future__ import annotations

import threading
from collections.abc import Callable, Hashable
from typing import Any


class Fits:
    """What follows from the versions of parts of a scene alone, kept from plan to plan.

    A version never stands for another content in the same process, so nothing here is ever out of date. Any thread may
    ask.
    """

    def __init__(self, most: int) -> None:
        self._most = most
        self._held: dict[Hashable, Any] = {}
        self._lock = threading.Lock()

    def get(self, key: Hashable, make: Callable[[], Any]) -> Any:
        """What is kept under a key, or else what `make` gives."""
        with self._lock:
            if key in self._held:
                return self._held[key]
        made = make()
        with self._lock:
            while len(self._held) >= self._most:
                self._held.pop(next(iter(self._held)))
            self._held[key] = made
        return made


#: Fits of all maps of a few plans of many lights and volumes; each takes about a kilobyte.
FITS = Fits(20_000)
