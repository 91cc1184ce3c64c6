"""The commands in processes of their own, and small stages to run them on."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
import pytest
from small_stages import CAMERA, LIGHT_AND_GROUND, ball, usda, volume

import previs
from previs import vdb

Run = Callable[..., subprocess.CompletedProcess[str]]


@pytest.fixture(scope="session", autouse=True)
def opengl(renderer: previs.Renderer) -> None:
    """Skip these tests where there is no OpenGL."""


@pytest.fixture(scope="session")
def run() -> Run:
    """``previs`` with arguments; environment variables may be added."""

    def run_previs(*arguments: object, environment: Mapping[str, str] | None = None, cwd: Path | None = None):
        return subprocess.run(
            [sys.executable, "-m", "previs.cli", *map(str, arguments)],
            capture_output=True,
            text=True,
            timeout=120,
            env={**os.environ, **(environment or {})},
            cwd=cwd,
            stdin=subprocess.DEVNULL,
            check=False,
        )

    return run_previs


@pytest.fixture(scope="session")
def stages(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of stages. `smoke.usda` is whole; `animated.usda` misses its file at frame 2."""
    folder = tmp_path_factory.mktemp("stages")
    with previs.Scene() as scene:
        scene.add_volume("/Smoke", ball(), bounds=((-1, -1, -1), (1, 1, 1)), extinction=4, albedo=0.8)
        scene.set_medium("/Smoke", emission=(0.2, 0.1, 0.0))
        scene.add_ground("/Ground", height=-1.2, size=20)
        scene.add_distant_light("/Sun", direction=(1, -2, -1), irradiance=3)
        scene.add_camera("/Cameras/Front", position=(0, 0.5, 6), target=(0, 0, 0))
        scene.add_camera("/Cameras/Top", position=(0, 8, 0.1), target=(0, 0, 0))
        scene.save(folder / "smoke.usda")
    transform = np.diag([2 / 12, 2 / 12, 2 / 12, 1.0])
    transform[3, :3] = -1.0 + 1 / 12
    vdb.write(folder / "ball.vdb", [vdb.Grid.from_dense("density", ball(), transform)])
    animated = volume("ball.vdb").replace(
        "asset filePath = @ball.vdb@",
        "asset filePath.timeSamples = { 1: @ball.vdb@, 2: @missing.vdb@, 3: @ball.vdb@, }",
    )
    # Time samples have braces of their own, on one line.
    (folder / "animated.usda").write_text(usda(LIGHT_AND_GROUND + CAMERA) + animated)
    return folder
