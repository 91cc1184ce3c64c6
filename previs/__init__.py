"""previs: a volumetric previewer for USD stages.

Smoke, clouds and fire in a USD stage, lit and shadowed: open or build a scene, render it, save the picture.

    import previs
    with previs.open("shot.usda") as scene:
        previs.render(scene, size=(960, 540)).save("shot.exr")
"""

from __future__ import annotations

from .api import open, render
from .description import Camera, Medium, Note
from .errors import PrevisError
from .image import Image
from .index import RenderIndex
from .render.renderer import Renderer
from .scene import Scene
from .settings import Settings

__version__ = "0.1.0"

__all__ = [
    "Camera",
    "Image",
    "Medium",
    "Note",
    "PrevisError",
    "RenderIndex",
    "Renderer",
    "Scene",
    "Settings",
    "open",
    "render",
]
