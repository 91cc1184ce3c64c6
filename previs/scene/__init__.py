"""Scenes in Python: open a stage or build one from arrays, edit it, save it.

`scene` holds the class `Scene`, `building` the part of it that adds prims. What is authored on a medium, a light or a
volume's voxels, and what is checked before, has a module of its own, without a state.
"""

from .light import LightValues
from .outline import OutlineItem
from .scene import Scene
from .timing import TimeRange

__all__ = ["LightValues", "OutlineItem", "Scene", "TimeRange"]
