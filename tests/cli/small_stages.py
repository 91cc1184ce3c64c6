"""Pieces of .usda text for the tests of the commands."""

from __future__ import annotations

import numpy as np


def ball(size: int = 12) -> np.ndarray:
    axis = np.linspace(-1.0, 1.0, size)
    distance = np.sqrt(sum(c**2 for c in np.meshgrid(axis, axis, axis)))
    return np.clip(1.2 - distance, 0.0, 1.0).astype(np.float32)


def usda(body: str) -> str:
    """A .usda file with that body; the format wants a line end before a closing brace."""
    return "#usda 1.0\n" + body.replace("}", "\n}\n")


LIGHT_AND_GROUND = """
def DistantLight "Sun" { float inputs:angle = 0.53
    float inputs:intensity = 3
    bool inputs:normalize = 1
    float3 xformOp:rotateXYZ = (-50, 20, 0)
    uniform token[] xformOpOrder = ["xformOp:rotateXYZ"] }
def Mesh "Ground" {
    int[] faceVertexCounts = [4]
    uniform token subdivisionScheme = "none"
    int[] faceVertexIndices = [0, 1, 2, 3]
    point3f[] points = [(-9, -1, 9), (9, -1, 9), (9, -1, -9), (-9, -1, -9)]
    color3f[] primvars:displayColor = [(0.5, 0.5, 0.5)] }
"""

CAMERA = """
def Camera "Cam" { float focalLength = 35
    float horizontalAperture = 36
    float verticalAperture = 24
    double3 xformOp:translate = (0, 0, 8)
    uniform token[] xformOpOrder = ["xformOp:translate"] }
"""


def volume(file: str, name: str = "Smoke", grid: str = "density", extra: str = "") -> str:
    return f"""
def Volume "{name}" {{
    rel field:density = </{name}/density>
    {extra}
    def OpenVDBAsset "density" {{
        asset filePath = @{file}@
        token fieldName = "{grid}"
    }}
}}
"""
