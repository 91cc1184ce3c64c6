"""What a translator of one prim works with: where and when it reads, and where it puts the records it makes."""

from __future__ import annotations

from collections import Counter
from collections.abc import Hashable, Iterable
from dataclasses import dataclass, field

import numpy as np
from pxr import Sdf, Usd, UsdGeom

from ..description import Camera, Light, Mesh, Note, NoteKind, Volume
from .field import GridCache
from .geometry import GeometryCache


@dataclass
class Context:
    """One reading of a stage at one time; the caches outlive it."""

    stage: Usd.Stage
    time: Usd.TimeCode
    xforms: UsdGeom.XformCache
    grids: GridCache
    geometries: GeometryCache
    counters: Counter[str]
    purposes: frozenset[str] = frozenset(("default", "render"))
    keep_going: bool = False


@dataclass(frozen=True, eq=False)
class Placement:
    """The places where a prim appears: one for an ordinary prim, K inside a PointInstancer.

    `matrices` is (K, 4, 4), local to world. `indices` is (K, depth): the instance index in every PointInstancer around
    the prim, outermost first; depth is 0 for an ordinary prim. `instancer` is the innermost PointInstancer.
    """

    matrices: np.ndarray
    indices: np.ndarray
    instancer: Sdf.Path | None = None

    @staticmethod
    def single(matrix: np.ndarray) -> Placement:
        """The placement of an ordinary prim."""
        return Placement(np.asarray(matrix, float)[None], np.zeros((1, 0), int))

    def label(self, k: int) -> str:
        """What is appended to the prim's path for place k: ``[i]`` per PointInstancer around it."""
        return "".join(f"[{i}]" for i in self.indices[k])


@dataclass
class Translation:
    """What one prim gave, and the prims it depends on: a change in or above any of their subtrees makes it stale.

    `fields` are the field prims that it reads, with the names of their relationships, `grid_files` the files of their
    grids by the grids' keys. `varying` is whether it may differ at another time, None where nobody has looked yet.
    """

    path: Sdf.Path
    volumes: list[Volume] = field(default_factory=list)
    lights: list[Light] = field(default_factory=list)
    meshes: list[Mesh] = field(default_factory=list)
    cameras: list[Camera] = field(default_factory=list)
    notes: list[Note] = field(default_factory=list)
    dependencies: set[Sdf.Path] = field(default_factory=set)
    fields: dict[Sdf.Path, str] = field(default_factory=dict)
    grid_files: dict[Hashable, str] = field(default_factory=dict)
    subdivided: bool = False
    varying: bool | None = None

    def __post_init__(self) -> None:
        self.dependencies.add(self.path)

    def depend(self, prim: Usd.Prim) -> None:
        """Remember a prim that is read: its change makes this translation stale, its animation makes it varying."""
        self.dependencies.add(prim.GetPath())
        # Whatever instances share changes under the paths of prototypes: that of the instance around the prim, and
        # where this instance is itself within another one, that of the outer one too.
        while prim.IsInstanceProxy():
            self.dependencies.add(prim.GetPrimInPrototype().GetPath())
            prim = prim.GetParent()
            while not prim.IsInstance():
                prim = prim.GetParent()

    def note(self, kind: NoteKind, prim: Usd.Prim | Sdf.Path | str, message: str) -> None:
        """Report something that the picture does not show as authored."""
        path = prim.GetPath() if isinstance(prim, Usd.Prim) else prim
        self.notes.append(Note(kind, str(path), message))

    def stale(self, dirty: Iterable[Sdf.Path]) -> bool:
        """Whether a change of any of these prims may change this translation."""
        return any(own.HasPrefix(changed) or changed.HasPrefix(own) for changed in dirty for own in self.dependencies)
