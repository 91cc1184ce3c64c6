"""What changed on a stage since it was last read."""

from __future__ import annotations

import weakref
from dataclasses import dataclass, field

from pxr import Sdf, Tf, Usd

#: Stage metadata that no translated prim depends on; the up axis belongs to the description alone.
_HARMLESS_STAGE_FIELDS = frozenset(
    "comment documentation defaultPrim upAxis metersPerUnit customLayerData framesPerSecond startTimeCode "
    "endTimeCode startFrame endFrame subLayers subLayerOffsets owner sessionOwner".split()
)

#: Properties that decide what a prim is to a renderer, or whether it is shown.
_STRUCTURAL = ("visibility", "purpose", "material:binding", "outputs:", "collection:")


@dataclass
class Changes:
    """Changed prims with the names of their changed properties, and prims whose whole subtree was recomposed.

    `up_axis` changes the description without any prim. `everything` asks for a complete translation: something
    changed whose reach is not known.
    """

    properties: dict[Sdf.Path, set[str]] = field(default_factory=dict)
    resynced: set[Sdf.Path] = field(default_factory=set)
    up_axis: bool = False
    everything: bool = False

    def __bool__(self) -> bool:
        return bool(self.properties or self.resynced or self.up_axis or self.everything)


class ChangeTracker:
    """Gathers the change notices of one stage until they are taken.

    `structure` moves when prims come, go or may have become something else, or are shown or hidden; not with values.
    """

    def __init__(self, stage: Usd.Stage) -> None:
        self._changes = Changes()
        self.structure = 0
        # The callback must not keep the tracker alive, and the key keeps the registration alive.
        tracker = weakref.ref(self)

        def on_change(notice: Usd.Notice.ObjectsChanged, _sender: object) -> None:
            alive = tracker()
            if alive is not None:
                alive._gather(notice)

        self._callback = on_change
        self._key = Tf.Notice.Register(Usd.Notice.ObjectsChanged, on_change, stage)

    def take(self) -> Changes:
        """The changes since the last call."""
        changes, self._changes = self._changes, Changes()
        return changes

    @property
    def pending(self) -> bool:
        """Whether something changed since `take` was last called."""
        return bool(self._changes)

    def close(self) -> None:
        """Stop listening."""
        self._key.Revoke()

    def _gather(self, notice: Usd.Notice.ObjectsChanged) -> None:
        for path in notice.GetResyncedPaths():
            # A property that gains its first value in a layer arrives as a resync of that property alone.
            if path.IsPropertyPath():
                self._property(path)
            else:
                self._changes.resynced.add(path)
                self.structure += 1
        for path in notice.GetResolvedAssetPathsResyncedPaths():
            if path.IsPropertyPath():
                self._property(path)
        for path in notice.GetChangedInfoOnlyPaths():
            fields = notice.GetChangedFields(path)
            if path.IsPropertyPath():
                self._property(path)
            elif path == Sdf.Path.absoluteRootPath:
                self.structure += 1
                self._changes.up_axis |= "upAxis" in fields
                self._changes.everything |= not _HARMLESS_STAGE_FIELDS.issuperset(fields)
            elif fields:
                # Metadata of a prim, such as an applied schema; empty fields only mean that a spec was made.
                self._changes.properties.setdefault(path, set())

    def _property(self, path: Sdf.Path) -> None:
        name = path.name
        self.structure += name.startswith(_STRUCTURAL)
        self._changes.properties.setdefault(path.GetPrimPath(), set()).add(name)
        # A collection may bind materials or link lights anywhere.
        self._changes.everything |= name.startswith("collection:") or ":collection:" in name
