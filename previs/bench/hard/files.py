"""Hard cases of what is read: files that are missing, cut short or corrupted, bad voxels; and scenes that lack a part.

The stages are written to a folder of their own, read as a user's would be, and removed.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from ... import vdb
from ...api import choose_camera
from ...description import SceneDescription
from ...errors import PrevisError
from ...scene import Scene
from .media import COARSE
from .records import CLOUD, FRONT, SIDE, box_mesh, cloud, cube_transform, distant, scene
from .trial import ANY, Trial, case

_STAGE = """#usda 1.0
def Volume "Smoke" (prepend apiSchemas = ["MaterialBindingAPI"]) {
    rel material:binding = </Fog>
    rel field:density = </Smoke/density>
    def OpenVDBAsset "density" { asset filePath = @./smoke.vdb@
        token fieldName = "density"
    }
}
def Material "Fog" {
    token outputs:volume.connect = </Fog/Shader.outputs:out>
    def Shader "Shader" {
        uniform token info:id = "PrevisVolume"
        color3f inputs:extinction = (3, 3, 3)
        float inputs:anisotropy = ANISOTROPY
        token outputs:out
    }
}
def DistantLight "Sun" { float inputs:intensity = 3
    bool inputs:normalize = 1
}
"""


@contextmanager
def _stage(values: np.ndarray | None = CLOUD, anisotropy: float = 0.3) -> Iterator[Path]:
    """A stage beside smoke.vdb, which is not there without values."""
    with tempfile.TemporaryDirectory(prefix="previs-hard-") as folder:
        path = Path(folder) / "stage.usda"
        path.write_text(_STAGE.replace("ANISOTROPY", repr(anisotropy)))
        if values is not None:
            array = np.asarray(values, np.float32)
            vdb.write(path.with_name("smoke.vdb"), [vdb.Grid.from_dense("density", array, cube_transform(array.shape))])
        yield path


def _described(path: Path, keep_going: bool = False) -> SceneDescription:
    with Scene.open(path, keep_going=keep_going) as opened:
        return opened.describe()


@case("missing file", methods=(ANY,))
def missing_file(trial: Trial) -> None:
    """Refused by the name of the prim and the file; or, going on, left out with a note."""
    with _stage(None) as path:
        trial.refused(lambda: _described(path), "/Smoke", "smoke.vdb")
        described = _described(path, keep_going=True)
        trial.told(described.notes, "smoke.vdb")
        trial.measure(trial.render(described, FRONT).color.max(), 0.0, "light from a missing file")
        trial.refused(lambda: Scene.open(path.with_name("nothing.usda")), "nothing.usda")


@case("truncated file", methods=(ANY,))
def truncated_file(trial: Trial) -> None:
    """A .vdb file cut short anywhere is refused by name: none reads as a thinner cloud."""
    with _stage() as path:
        file = path.with_name("smoke.vdb")
        whole = file.read_bytes()
        for part in (0.0, 0.01, 0.1, 0.3, 0.5, 0.7, 0.9, 0.99):
            file.write_bytes(whole[: int(part * len(whole))])
            trial.refused(lambda: _described(path), "smoke.vdb")


@case("corrupted file", methods=(ANY,))
def corrupted_file(trial: Trial) -> None:
    """Bytes overwritten anywhere: refused by name, or a picture within its bounds, since voxels have no checksum."""
    random = np.random.default_rng(11)
    with _stage() as path:
        file = path.with_name("smoke.vdb")
        whole = file.read_bytes()
        file.write_bytes(b"not a grid" + whole[10:])
        trial.refused(lambda: _described(path), "smoke.vdb")
        for number in range(24):
            damaged = bytearray(whole)
            # Half of the damage goes where the structure is: headers, offsets and the first nodes.
            reach = 1200 if number % 2 else len(whole)
            for _ in range(1 + number % 3):
                damaged[int(random.integers(min(reach, len(whole))))] = int(random.integers(256))
            file.write_bytes(damaged)
            _read_or_refused(trial, lambda: _described(path))


def _read_or_refused(trial: Trial, read: Callable[[], SceneDescription]) -> None:
    try:
        described = read()
        trial.render(described, FRONT, **COARSE)
    except PrevisError as error:
        trial.measure("\n" in str(error) or "smoke.vdb" not in str(error), 0.0, "not one line with the file", "flag")


@case("NaN voxels", "infinite voxels", "negative voxels", methods=(ANY,))
def bad_voxels(trial: Trial) -> None:
    """Cleaned, counted and reported; the picture is that of the same grid with zeros and its largest value."""
    bad, good = CLOUD.copy(), CLOUD.copy()
    largest = float(np.float32(CLOUD.max()))
    for value, instead, places in (
        (np.nan, 0.0, ((5, 7, 6), (6, 7, 6))),
        (np.inf, largest, ((7, 8, 5),)),
        (-2.0, 0.0, ((4, 4, 4), (4, 5, 4), (4, 6, 4))),
    ):
        for i in places:
            bad[i], good[i] = value, instead
    with _stage(bad) as path:
        described = _described(path)
    with _stage(good) as path:
        expected = _described(path)
    trial.told(described.notes, "2 NaN", "1 infinite", "3 negative", "cleaned")
    trial.same(trial.render(described, FRONT, **COARSE), trial.render(expected, FRONT, **COARSE), 1e-6)


@case("NaN voxels", "infinite voxels", "negative voxels", methods=(ANY,))
def nothing_but_bad_voxels(trial: Trial) -> None:
    """A grid of NaN, of infinities, of negative values: nothing is left, and it is said."""
    for value in (np.nan, np.inf, -1.0):
        with _stage(np.full((6, 6, 6), value)) as path:
            described = _described(path)
        trial.told(described.notes, "216", "cleaned")
        image = trial.render(described, FRONT)
        trial.measure(max(image.color.max(), image.alpha.max()), 0.0, "light from nothing")


@case("anisotropy towards ±1", methods=(ANY,))
def anisotropy_beyond_its_limit(trial: Trial) -> None:
    """g of ±1 and beyond is taken as ±0.999, and that is said."""
    for g in (1.0, -1.0, 3.0):
        with _stage(anisotropy=g) as path:
            described = _described(path)
        with _stage(anisotropy=float(np.clip(g, -0.999, 0.999))) as path:
            expected = _described(path)
        trial.told(described.notes, "anisotropy", "0.999")
        trial.same(trial.render(described, FRONT, **COARSE), trial.render(expected, FRONT, **COARSE), 1e-6)


@case("no lights", methods=(ANY,))
def no_lights(trial: Trial) -> None:
    """Black, and as opaque as with lights."""
    dark = trial.render(scene(cloud(3.0), box_mesh((-2, -1.6, -2), (2, -1.4, 2))), FRONT, **COARSE)
    lit = trial.render(scene(cloud(3.0), box_mesh((-2, -1.6, -2), (2, -1.4, 2)), SIDE), FRONT, **COARSE)
    trial.measure(dark.color.max(), 0.0, "light from nowhere")
    trial.measure(np.abs(dark.alpha - lit.alpha).max(), 1e-6, "opacity that depends on light")


@case("no camera", methods=(ANY,))
def no_camera(trial: Trial) -> None:
    """A stage without a camera is seen from a place that frames all of it; asking for a camera by name is refused."""
    with _stage() as path, Scene.open(path) as opened:
        described = opened.describe()
        view = choose_camera(opened, described, None, None)
        image = trial.render(described, view)
        alpha = image.alpha
        covered = float(np.mean(alpha > 0.01))
        edge = max(alpha[0].max(), alpha[-1].max(), alpha[:, 0].max(), alpha[:, -1].max())
        trial.measure(0.05 / max(covered, 1e-9), 1.0, "least part of the picture over what is covered:")
        trial.measure(edge, 0.01, "medium cut by the frame")
        trial.refused(lambda: choose_camera(opened, described, "Nobody", None), "Nobody")


@case("no volume", methods=(ANY,))
def no_volume(trial: Trial) -> None:
    """Meshes alone are lit as ever; an empty stage is an empty picture."""
    trial.right(scene(box_mesh((-0.7,) * 3, (0.7,) * 3), distant((-1.0, -0.7, -0.4))), shadow_map_size=4096)
    for held in (scene(SIDE), scene()):
        image = trial.render(held)
        trial.measure(max(image.color.max(), image.alpha.max()), 0.0, "light from nothing")
