"""USD → scene description: the only place that reads pxr schemas.

One module per kind of prim (`volume`, `light`, `mesh`, …) translates one prim into the plain records of
`previs.description`; `reader` walks the stage, remembers what each prim gave and what it depended on, and translates
again only what a change notice (`changes`) touched. Heavy data, voxels and triangles, lives in caches of its own
(`field`, `geometry`), so that even a translation made anew does not read it again.
"""

from .camera import default_camera, find_camera
from .opening import open_stage
from .reader import StageReader
from .render_settings import RenderSettings, read_render_settings

__all__ = [
    "RenderSettings",
    "StageReader",
    "default_camera",
    "find_camera",
    "open_stage",
    "read_render_settings",
]
