"""Windows for tests: each scenario runs in a process of its own, on a platform without a display."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

HERE = Path(__file__).resolve().parent
SCENES = HERE.parents[1] / "scenes"


@pytest.fixture(scope="session")
def _window_library() -> None:
    """Skips where the window's libraries are missing or there is no EGL, with the reason."""
    probe = (
        "from imgui_bundle import imgui; import glfw;"
        "glfw.init_hint(glfw.PLATFORM, glfw.PLATFORM_NULL); assert glfw.init();"
        "glfw.window_hint(glfw.CONTEXT_CREATION_API, glfw.EGL_CONTEXT_API);"
        "assert glfw.create_window(64, 64, 'x', None, None)"
    )
    found = subprocess.run([sys.executable, "-c", probe], capture_output=True, text=True, timeout=60, check=False)
    if found.returncode != 0:
        pytest.skip(f"no window can be made here: {found.stderr.strip().splitlines()[-1:]}")


@pytest.fixture
def drive(_window_library: None, tmp_path: Path) -> Callable[..., Path]:
    """Run a scenario by name with a stage; returns the folder it may have written to. Its failure is the test's."""

    def run(scenario: str, stage: str | Path | None = SCENES / "plume.usda", **environment: str) -> Path:
        arguments = [sys.executable, str(HERE / "driver.py"), scenario, str(tmp_path)]
        if stage is not None:
            arguments.append(str(stage))
        done = subprocess.run(
            arguments,
            capture_output=True,
            text=True,
            timeout=400,
            check=False,
            env={**os.environ, **environment},
        )
        if done.returncode != 0:
            pytest.fail(f"{scenario}: exit status {done.returncode}\n{done.stdout[-4000:]}\n{done.stderr[-6000:]}")
        return tmp_path

    return run
