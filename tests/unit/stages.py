"""Small stages for the tests of the reader: usda text in, description out."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from pxr import Usd

from previs import vdb
from previs.description import Light, Mesh, Note, SceneDescription, Volume
from previs.stage import StageReader

PREVIS_VOLUME = """
def Material "M" {
    token outputs:volume.connect = </M/S.outputs:out>
    def Shader "S" {
        uniform token info:id = "PrevisVolume"
        token outputs:out
        %s
    }
}
"""

#: A volume with the field density of smoke.vdb beside the stage, and a light that changes.
SMOKE_AND_LAMP = """
def Volume "V" (prepend apiSchemas = ["MaterialBindingAPI"]) {
    rel material:binding = </M>
    rel field:density = </V/f>
    def OpenVDBAsset "f" { asset filePath = @./smoke.vdb@
        token fieldName = "density" }
}
def SphereLight "L" { float inputs:intensity.timeSamples = { 1: 1, 5: 5 } }
"""

QUAD = """
        int[] faceVertexCounts = [4]
        int[] faceVertexIndices = [0, 1, 2, 3]
        point3f[] points = [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)]
"""


def usda(text: str) -> str:
    """A .usda file with that body; the format wants a line end before a closing brace."""
    return "#usda 1.0\n" + text.replace("}", "\n}\n")


def stage_of(text: str) -> Usd.Stage:
    """A stage in memory from the body of a .usda file."""
    stage = Usd.Stage.CreateInMemory()
    stage.GetRootLayer().ImportFromString(usda(text))
    return stage


def describe(text: str, time: float | None = None, **options) -> SceneDescription:
    return StageReader(stage_of(text), **options).read(time)


def only(records: dict[str, Volume] | dict[str, Light] | dict[str, Mesh]):
    [record] = records.values()
    return record


def notes(scene: SceneDescription, kind: str | None = None) -> list[Note]:
    return [n for n in scene.notes if kind is None or n.kind == kind]


def write_field(path: Path, *names: str, value: float = 1.0, size: int = 4, transform=None) -> Path:
    """A .vdb file of cubes of one value."""
    path.parent.mkdir(parents=True, exist_ok=True)
    array = np.full((size,) * 3, value, np.float32)
    vdb.write(path, [vdb.Grid.from_dense(name, array, transform) for name in names or ("density",)])
    return path


def volume_text(file: str, field: str = "density", grid: str = "density", extra: str = "", name: str = "V") -> str:
    """A Volume with one field."""
    return f"""
def Volume "{name}" {{
    rel field:{field} = </{name}/f>
    def OpenVDBAsset "f" {{
        asset filePath = @{file}@
        token fieldName = "{grid}"
        {extra}
    }}
}}
"""
