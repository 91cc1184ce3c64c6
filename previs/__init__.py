"""previs: a volumetric previewer for USD stages.

Smoke, clouds and fire in a USD stage, lit and shadowed: open or build a scene, render it, save the picture.

    import previs
    with previs.open("shot.usda") as scene:
        previs.render(scene, size=(960, 540)).save("shot.exr")
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

# The function `render` takes the place of the package in this namespace; loaded later, the package would take it back.
from . import render as _package  # noqa: F401
from .api import open, render
from .errors import PrevisError

if TYPE_CHECKING:
    from .description import Camera, Medium, Note
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

#: Where the public names are that are loaded when they are first asked for: USD and numpy take longer to load than
#: most commands that need neither take to run.
_MODULES = {
    "Camera": "description",
    "Image": "image",
    "Medium": "description",
    "Note": "description",
    "RenderIndex": "index",
    "Renderer": "render.renderer",
    "Scene": "scene",
    "Settings": "settings",
}


def __getattr__(name: str) -> Any:
    module = _MODULES.get(name)
    if module is None:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from importlib import import_module

    value = globals()[name] = getattr(import_module(f".{module}", __name__), name)
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
