"""The render index: the descriptions of a scene by path, each part with a version.

A version is a number that moves only when the part it belongs to changes. Passes remember the versions they were
made from and run again only when one of them moved, so nobody has to be called back.
"""

from __future__ import annotations

import itertools
from collections.abc import Hashable, Mapping
from dataclasses import dataclass, field

from .description import Camera, Light, Mesh, Note, SceneDescription, Volume

_counter = itertools.count(1)

Record = Volume | Light | Mesh


@dataclass
class Entry:
    """One record, the comparable keys of its parts, and the version of each part."""

    record: Record
    keys: dict[str, Hashable]
    versions: dict[str, int]


@dataclass
class RenderIndex:
    """Volumes, lights and meshes by path; `update` takes in a description and moves the versions that changed.

    Versions come from one counter of the process, so a version number never returns for another content, not even in
    another index.
    """

    volumes: dict[str, Entry] = field(default_factory=dict)
    lights: dict[str, Entry] = field(default_factory=dict)
    meshes: dict[str, Entry] = field(default_factory=dict)
    notes: tuple[Note, ...] = ()
    scene: SceneDescription = field(default_factory=SceneDescription)

    def update(self, scene: SceneDescription) -> None:
        """Take in a description: records that are gone leave, new ones enter, changed parts get new versions."""
        self.scene, self.notes = scene, scene.notes
        self._update(self.volumes, scene.volumes)
        self._update(self.lights, scene.lights)
        self._update(self.meshes, scene.meshes)

    def _update(self, entries: dict[str, Entry], records: Mapping[str, Record]) -> None:
        for path in set(entries) - set(records):
            del entries[path]
        for path, record in records.items():
            keys = dict(record.parts())
            entry = entries.get(path)
            if entry is None:
                entries[path] = Entry(record, keys, {part: self._next() for part in keys})
                continue
            for part, key in keys.items():
                if entry.keys.get(part) != key:
                    entry.versions[part] = self._next()
            entry.record, entry.keys = record, keys
        # The order of a dictionary is the order of drawing; it follows the stage's.
        if list(entries) != list(records):
            ordered = {path: entries[path] for path in records}
            entries.clear()
            entries.update(ordered)

    @staticmethod
    def _next() -> int:
        return next(_counter)


def camera_key(camera: Camera) -> Hashable:
    """A hashable stand-in for a camera's view."""
    return tuple(camera.parts().items())
