"""The cache of triangles, and the marks by which equal triangles are known."""

from __future__ import annotations

import hashlib
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
from pxr import Sdf, Usd

from ..description import Geometry, Note
from .changes import Changes

_PROPERTIES = frozenset(
    "points faceVertexCounts faceVertexIndices holeIndices orientation normals subdivisionScheme indices elementType "
    "familyName size radius radiusTop radiusBottom height axis width length".split()
)
_PRIMVARS = ("primvars:displayColor", "primvars:normals")


@dataclass
class Part:
    """Triangles of a mesh that share a material: all of them, or those of the GeomSubset at `path`."""

    path: Sdf.Path
    geometry: Geometry


@dataclass
class BuiltGeometry:
    """The triangles of one prim; `parts` is empty where `notes` says what is wrong with it.

    The paths of `parts` are those of the prim that was read. The notes have no path yet: a prototype's prim has many.
    """

    parts: list[Part] = field(default_factory=list)
    notes: list[Note] = field(default_factory=list)
    time_varying: bool = False
    subdivided: bool = False


def content_key(*arrays: np.ndarray | None) -> tuple[str, str]:
    """A key that is equal for equal arrays, whatever file or prim they come from."""
    digest = hashlib.blake2b(digest_size=16)
    for array in arrays:
        if array is None:
            digest.update(b"none")
            continue
        digest.update(f"{array.dtype.str}{array.shape}".encode())
        digest.update(np.ascontiguousarray(array).data)
    return ("triangles", digest.hexdigest())


def make_geometry(
    points: np.ndarray, normals: np.ndarray, triangles: np.ndarray, colors: np.ndarray | None = None
) -> Geometry:
    """A Geometry in the contracted types, keyed by its content."""
    points = np.ascontiguousarray(points, np.float32)
    normals = np.ascontiguousarray(normals, np.float32)
    triangles = np.ascontiguousarray(triangles, np.uint32).reshape(-1, 3)
    if colors is not None:
        colors = np.ascontiguousarray(colors, np.float32)
    return Geometry(content_key(points, normals, triangles, colors), points, normals, triangles, colors)


class GeometryCache:
    """Triangles by prim path. An entry lasts until a property that shapes it changes, or its time does."""

    def __init__(self, counters: Counter[str]) -> None:
        self._built: dict[Sdf.Path, tuple[Usd.TimeCode, BuiltGeometry]] = {}
        self._variants: dict[tuple[object, bool, bool], Geometry] = {}
        self._counters = counters

    def get(self, path: Sdf.Path, time: Usd.TimeCode, build: Callable[[], BuiltGeometry]) -> BuiltGeometry:
        """The triangles of a prim, built only when they are not known for this time."""
        entry = self._built.get(path)
        if entry is not None:
            made_at, built = entry
            # A single sample varies at no time, but does not count at the default time.
            if made_at == time or (not built.time_varying and made_at.IsDefault() == time.IsDefault()):
                return built
        built = build()
        self._counters["geometry"] += 1
        self._built[path] = (time, built)
        return built

    def variant(self, geometry: Geometry, colors: bool, mirrored: bool) -> Geometry:
        """The same triangles without their colours, or wound the other way for a mirroring transform."""
        colors = colors or geometry.colors is None
        if colors and not mirrored:
            return geometry
        key = (geometry.key, colors, mirrored)
        found = self._variants.get(key)
        if found is None:
            found = replace(
                geometry,
                key=key,
                triangles=np.ascontiguousarray(geometry.triangles[:, ::-1]) if mirrored else geometry.triangles,
                colors=geometry.colors if colors else None,
            )
            self._variants[key] = found
        return found

    def forget(self, changes: Changes) -> None:
        """Drop what these changes make stale."""
        if changes.everything:
            # Whatever changed may remap time or values, so nothing read before it can be trusted.
            self._built.clear()
        for path in list(self._built):
            if any(path.HasPrefix(p) or p.HasPrefix(path) for p in changes.resynced):
                del self._built[path]
            # Paths of shared prototypes are handed out anew when the stage is recomposed.
            elif changes.resynced and Usd.Prim.IsPathInPrototype(path):
                del self._built[path]
            elif any(
                p.HasPrefix(path) and any(n in _PROPERTIES or n.startswith(_PRIMVARS) for n in names)
                for p, names in changes.properties.items()
            ):
                del self._built[path]

    def keep(self, used: set[object]) -> None:
        """Drop variants of geometry that is no longer in the picture."""
        for key in [k for k in self._variants if k[0] not in used and k not in used]:
            del self._variants[key]
