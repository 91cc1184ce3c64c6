"""Scenes in Python: open a stage or build one from arrays, edit it, save it.

`scene` holds the class `Scene`, `building` the part of it that adds prims. What is authored and taken back has a
module for each kind: `medium`, `light`, `voxels`, `knobs` and, for what a tree of prims shows, `outline`. `overrides`
keeps the edits as a whole, `files` and `saving` bring them to disk and back, `bare_vdb` makes a stage for a file
without one.
"""

from .light import LightValues
from .outline import OutlineItem
from .scene import Scene
from .timing import TimeRange

__all__ = ["LightValues", "OutlineItem", "Scene", "TimeRange"]
