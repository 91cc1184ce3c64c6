"""Stages for golden pictures that are about one thing each: shapes, instances, kinds of lights, a view from inside."""

from __future__ import annotations

from pathlib import Path

import numpy as np

import previs
from previs import vdb


def usda(body: str) -> str:
    """A .usda file with that body; the format wants a line end before a closing brace."""
    return "#usda 1.0\n" + body.replace("}", "\n}\n")


def medium(name: str, inputs: str) -> str:
    return f"""
def Material "{name}" {{ token outputs:volume.connect = </{name}/S.outputs:out>
    def Shader "S" {{ uniform token info:id = "PrevisVolume"
        token outputs:out
        {inputs} }} }}
"""


def prim(kind: str, name: str, *lines: str, applied: str = "") -> str:
    schemas = f'(prepend apiSchemas = ["{applied}"])' if applied else ""
    return f'def {kind} "{name}" {schemas} {{ ' + "\n    ".join(lines) + " }\n"


def placed(translate: tuple[float, float, float], rotate: tuple[float, float, float] = (0, 0, 0)) -> str:
    return f"""double3 xformOp:translate = {translate}
    float3 xformOp:rotateXYZ = {rotate}
    uniform token[] xformOpOrder = ["xformOp:translate", "xformOp:rotateXYZ"]"""


GROUND = """
def Mesh "Ground" { int[] faceVertexCounts = [4]
    int[] faceVertexIndices = [0, 1, 2, 3]
    point3f[] points = [(-9, 0, 6), (9, 0, 6), (9, 0, -9), (-9, 0, -9)]
    uniform token subdivisionScheme = "none"
    color3f[] primvars:displayColor = [(0.4, 0.4, 0.4)] }
"""

CAMERA = f"""
def Camera "Camera" {{ float focalLength = 30
    float horizontalAperture = 36
    float verticalAperture = 20.25
    {placed((0, 2.2, 9), (-9, 0, 0))} }}
"""

SUN = f"""
def DistantLight "Sun" {{ float inputs:intensity = 3
    bool inputs:normalize = 1
    {placed((0, 0, 0), (-50, -30, 0))} }}
"""


def shapes(folder: Path) -> Path:
    """Homogeneous box, sphere and capsule of different media, overlapping, shadowing the ground and one another."""

    def shape(kind: str, material: str, *lines: str) -> str:
        return prim(kind, kind, f"rel material:binding = </{material}>", *lines, applied="MaterialBindingAPI")

    body = (
        medium("Grey", "color3f inputs:extinction = (1.2, 1.2, 1.2)\n float inputs:anisotropy = 0.5")
        + medium("Red", "color3f inputs:extinction = (0.6, 1.8, 3)\n color3f inputs:albedo = (0.95, 0.7, 0.5)")
        + medium("Ray", 'color3f inputs:extinction = (2, 2, 2)\n token inputs:phase = "rayleigh"')
        + shape("Cube", "Grey", "double size = 2", placed((-2.6, 1.3, 0), (0, 35, 20)))
        + shape("Sphere", "Red", "double radius = 1.2", placed((0, 1.4, 0.6)))
        + shape(
            "Capsule",
            "Ray",
            "double radius = 0.7",
            "double height = 1.6",
            'uniform token axis = "X"',
            placed((2, 1.6, 0), (0, 20, 35)),
        )
    )
    path = folder / "shapes.usda"
    path.write_text(usda(body + GROUND + SUN + CAMERA))
    return path


def instances(folder: Path) -> Path:
    """A PointInstancer of a volume: turned, stretched and mirrored copies of one lopsided cloud."""
    axis = np.linspace(-1.0, 1.0, 20)
    x, y, z = np.meshgrid(axis, axis, axis, indexing="ij")
    distance = np.sqrt((x - 0.2 * y) ** 2 + (0.8 * y) ** 2 + (1.2 * z) ** 2)
    density = np.clip(1.1 - distance, 0.0, 1.0) * (1.0 + 0.6 * np.sin(7.0 * x) * np.sin(5.0 * y))
    transform = np.diag([0.1, 0.1, 0.1, 1.0])
    transform[3, :3] = -0.95
    vdb.write(folder / "puff.vdb", [vdb.Grid.from_dense("density", density.astype(np.float32), transform)])
    body = (
        medium("Smoke", "color3f inputs:extinction = (4, 4, 4)\n color3f inputs:albedo = (0.9, 0.85, 0.8)")
        + """
def PointInstancer "Puffs" { int[] protoIndices = [0, 0, 0, 0]
    point3f[] positions = [(-3, 1.2, 0), (-0.6, 1.1, 1), (1.2, 1.5, -1), (3.4, 1.2, 0)]
    float3[] scales = [(1, 1, 1), (0.6, 1.1, 0.6), (1.3, 0.8, 1), (-1, 1, 1)]
    quath[] orientations = [(1, 0, 0, 0), (0.924, 0, 0.383, 0), (0.966, 0.259, 0, 0), (0.924, 0, 0, 0.383)]
    rel prototypes = </Puffs/Puff>
    def Volume "Puff" (prepend apiSchemas = ["MaterialBindingAPI"]) { rel material:binding = </Smoke>
        rel field:density = </Puffs/Puff/density>
        def OpenVDBAsset "density" { asset filePath = @puff.vdb@
            token fieldName = "density" } } }
"""
    )
    path = folder / "instances.usda"
    path.write_text(usda(body + GROUND + SUN + CAMERA))
    return path


def lights(folder: Path) -> Path:
    """One light of every kind, in mist over a ground, with a wall to throw shadows."""

    def light(kind: str, name: str, *where: str, color: str = "(1, 1, 1)", applied: str = "", **inputs: float) -> str:
        values = [f"float inputs:{n.replace('_', ':')} = {v}" for n, v in inputs.items()]
        return prim(kind, name, f"color3f inputs:color = {color}", *values, *where, applied=applied)

    normalized, warm = "bool inputs:normalize = 1", "bool inputs:enableColorTemperature = 1"
    downwards, shaping = (-90, 0, 0), {"shaping_cone_angle": 18, "shaping_cone_softness": 0.4, "shaping_focus": 4}
    body = (
        medium("Mist", "color3f inputs:extinction = (0.12, 0.12, 0.12)\n float inputs:anisotropy = 0.3")
        + prim(
            "Volume",
            "Fog",
            "rel material:binding = </Mist>",
            "float3[] extent = [(-6, 0.01, -5), (6, 4, 4)]",
            applied="MaterialBindingAPI",
        )
        + light("DistantLight", "Sun", normalized, placed((0, 0, 0), (-40, 60, 0)), intensity=0.3)
        + light("DomeLight", "Sky", color="(0.02, 0.03, 0.05)")
        + light("SphereLight", "Bulb", normalized, placed((-4, 1.2, 1)), color="(1, 0.6, 0.3)", intensity=8, radius=0.1)
        + light(
            "SphereLight",
            "Spot",
            normalized,
            warm,
            placed((-1.5, 5, 0), downwards),
            applied="ShapingAPI",
            intensity=400,
            radius=0.05,
            colorTemperature=9000,
            **shaping,
        )
        + light("DiskLight", "Disk", placed((1, 3.4, -1), downwards), intensity=60, radius=0.3)
        + light(
            "RectLight",
            "Panel",
            placed((3, 2, -3), (0, 180, 0)),
            color="(0.4, 0.6, 1)",
            intensity=20,
            width=1.2,
            height=0.5,
        )
        + light(
            "CylinderLight",
            "Tube",
            placed((4.4, 1, 1), (0, 0, 90)),
            color="(0.5, 1, 0.5)",
            intensity=12,
            length=1.5,
            radius=0.05,
        )
        + prim("Cube", "Wall", "double size = 1.4", placed((-2.6, 0.7, 0.4), (0, 30, 0)))
    )
    path = folder / "lights.usda"
    path.write_text(usda(body + GROUND + CAMERA))
    return path


def inside(folder: Path) -> Path:
    """Camera and bulb inside a coloured medium that glows, a ball in it, an aperture off its centre."""
    with previs.Scene(up_axis="Z") as scene:
        axis = np.linspace(0.0, 1.0, 24)
        x, y, z = np.meshgrid(axis, axis, axis, indexing="ij")
        density = 0.4 + 0.3 * np.sin(9.0 * x + 2.0 * z) * np.cos(7.0 * y)
        heat = 1800.0 * np.clip(1.0 - 3.0 * np.hypot(x - 0.5, y - 0.7), 0.0, 1.0)
        scene.add_volume(
            "/Haze",
            density,
            bounds=((-4, -4, 0), (4, 4, 4)),
            temperature=heat,
            extinction=(0.5, 0.35, 0.25),
            albedo=0.8,
        )
        scene.set_medium(
            "/Haze", emission=1.0, emission_scale=300.0, phase="two_lobe", anisotropy=0.7, anisotropy2=-0.3
        )
        scene.set_medium("/Haze", lobe_mix=0.4)
        scene.add_sphere_light("/Bulb", (-1.5, 1.5, 2.6), radiant_intensity=12)
        scene.add_ground(height=0.2, size=8, color=(0.3, 0.35, 0.4))
        scene.add_camera("/Camera", position=(0.5, -3.5, 1.8), target=(0, 1, 1.6), focal_length=22)
        scene.save(folder / "inside.usda")
    return folder / "inside.usda"


MADE = {"shapes": shapes, "instances": instances, "lights": lights, "inside": inside}
