"""``previs doctor``: whether this machine can render, with what, and what to do if not."""

from __future__ import annotations

import argparse
import importlib.metadata
import os
import platform
import sys


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the command: none."""


def run(arguments: argparse.Namespace) -> int:
    """Print what was found; 0 when a picture can be rendered, 1 when not."""
    print(f"Python {platform.python_version()} on {platform.platform()}")
    for package in (
        "usd-core",
        "moderngl",
        "glcontext",
        "numpy",
        "openimageio",
        "blosc",
        "flip-evaluator",
        "glfw",
        "imgui-bundle",
    ):
        try:
            version = importlib.metadata.version(package)
        except importlib.metadata.PackageNotFoundError:
            version = "missing: pip install " + package
        print(f"  {package:<15} {version}")
    set_here = {k: v for k, v in os.environ.items() if k.startswith(("PREVIS_", "LIBGL_", "MESA_", "OCIO"))}
    for name, value in sorted(set_here.items()):
        print(f"  {name}={value}")
    try:
        from ..render.context import ContextError, create_context, is_software
    except ImportError as error:
        print(f"OpenGL: a package is missing or broken: {error}")
        return 1
    try:
        context = create_context()
    except ContextError as error:
        print(f"OpenGL: no.\n  {error}")
        return 1
    info = context.info
    kind = "on the processor" if is_software(context) else "on the GPU"
    print(f"OpenGL {context.version_code / 100:.1f}, {kind}: {info['GL_RENDERER']} ({info['GL_VENDOR']})")
    for name, unit in (
        ("GL_MAX_TEXTURE_SIZE", "pixels along an image or a light-map atlas"),
        ("GL_MAX_3D_TEXTURE_SIZE", "voxels along a field; a larger field is reduced"),
        ("GL_MAX_UNIFORM_BLOCK_SIZE", "bytes of lights or volumes in one draw"),
        ("GL_MAX_TEXTURE_IMAGE_UNITS", "textures in one draw"),
    ):
        print(f"  {info[name]:>8}  {unit}")
    context.release()
    print(_window())
    print("ready to render", file=sys.stdout)
    return 0


def _window() -> str:
    """Whether `previs view` can open its window; rendering needs none."""
    from ..errors import PrevisError
    from ..ui.window import check_display, load_library

    try:
        check_display()
        load_library()
    except PrevisError as error:
        return f"window: no.\n  {error}"
    return "window: yes, previs view can open one"
