"""The window under a real display server with a real mouse and keyboard, where Xvfb and xdotool are installed."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

SCENES = Path(__file__).resolve().parents[2] / "scenes"
SIZE = (1280, 760)

pytestmark = [
    pytest.mark.window,
    pytest.mark.skipif(not (shutil.which("Xvfb") and shutil.which("xdotool")), reason="needs Xvfb and xdotool"),
]


def until(condition: Callable[[], object], what: str, seconds: float = 90.0) -> None:
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, f"waited {seconds:g} s for {what}"
        time.sleep(0.1)


class Desktop:
    """A display, and a hand at its mouse and keyboard."""

    def __init__(self, display: str) -> None:
        self.environment = {**os.environ, "DISPLAY": display}
        self.environment.pop("WAYLAND_DISPLAY", None)
        self.environment.pop("PREVIS_WINDOW", None)

    def do(self, *arguments: object) -> str:
        done = subprocess.run(
            ["xdotool", *map(str, arguments)],
            env=self.environment,
            capture_output=True,
            text=True,
            timeout=20,
            check=False,
        )
        time.sleep(0.15)
        return done.stdout.strip()

    def chord(self, modifier: str, key: str) -> None:
        """Hold a modifier as long as a hand does: xdotool's own are over between two frames of a busy window."""
        self.do("keydown", modifier)
        self.do("key", key)
        time.sleep(0.15)
        self.do("keyup", modifier)

    def titles(self) -> list[str]:
        windows = self.do("search", "--name", "previs").split()
        return [self.do("getwindowname", w) for w in windows]

    def drag(self, x: int, y: int, dx: int) -> None:
        self.do("mousemove", x, y)
        self.do("mousedown", 1)
        for i in range(1, 7):
            self.do("mousemove", x + dx * i // 6, y)
        self.do("mouseup", 1)


@pytest.fixture
def desktop() -> Iterator[Desktop]:
    read, write = os.pipe()
    server = subprocess.Popen(
        ["Xvfb", "-displayfd", str(write), "-screen", "0", f"{SIZE[0]}x{SIZE[1]}x24", "-nolisten", "tcp"],
        pass_fds=[write],
        stderr=subprocess.DEVNULL,
    )
    os.close(write)
    with os.fdopen(read) as pipe:
        number = pipe.readline().strip()
    try:
        assert number, "Xvfb did not start"
        yield Desktop(f":{number}")
    finally:
        server.terminate()
        server.wait(20)


def test_a_look_is_tuned_and_saved_by_hand(desktop: Desktop, tmp_path: Path) -> None:
    environment = {**desktop.environment, "PREVIS_CONFIG": str(tmp_path / "config"), "PATH": ""}
    for name in ("pyroclastic.usda", "pyroclastic.vdb"):
        shutil.copy(SCENES / name, tmp_path / name)
    stage = tmp_path / "pyroclastic.usda"
    # Without a PATH there is no program for system dialogs: our own browser asks for the file's name.
    log = (tmp_path / "log").open("w")
    window = subprocess.Popen(
        [sys.executable, "-m", "previs.cli", "view", str(stage)], env=environment, stdout=log, stderr=log
    )
    try:
        until(lambda: "pyroclastic.usda - previs" in desktop.titles(), "the window")
        time.sleep(1.0)
        desktop.do("mousemove", SIZE[0] // 2, SIZE[1] // 2)
        desktop.do("key", "4")
        until(lambda: "pyroclastic.usda • - previs" in desktop.titles(), "14 coefficients by key")
        desktop.chord("ctrl", "z")
        until(lambda: "pyroclastic.usda - previs" in desktop.titles(), "the undo")
        # The first knob of the panel at the right.
        desktop.drag(int(0.9 * SIZE[0]), 110, 60)
        until(lambda: "pyroclastic.usda • - previs" in desktop.titles(), "the dragged knob")
        desktop.drag(SIZE[0] // 2, SIZE[1] // 2, 120)
        for patience in (1.0, 4.0, 10.0):
            # Nothing tells from outside that the browser is open, and keys that come too early are shortcuts.
            desktop.chord("ctrl", "s")
            time.sleep(patience)
            desktop.chord("ctrl", "a")
            desktop.do("type", "tuned.usda")
            desktop.do("key", "Return")
            time.sleep(patience)
            if (tmp_path / "tuned.usda").exists():
                break
            desktop.do("key", "Escape")
        until((tmp_path / "tuned.usda").exists, "the saved layer")
        until(lambda: "pyroclastic.usda - previs" in desktop.titles(), "the title without a mark")
        assert "density_scale" in (tmp_path / "tuned.usda").read_text()
        desktop.chord("ctrl", "q")
        assert window.wait(60) == 0
    finally:
        if window.poll() is None:
            window.kill()
            window.wait(20)
        log.close()
    assert "Traceback" not in (tmp_path / "log").read_text()


def test_no_display_is_said_in_one_line(tmp_path: Path) -> None:
    environment = {k: v for k, v in os.environ.items() if k not in ("DISPLAY", "WAYLAND_DISPLAY", "PREVIS_WINDOW")}
    done = subprocess.run(
        [sys.executable, "-m", "previs.cli", "view", str(SCENES / "plume.usda")],
        env={**environment, "PREVIS_CONFIG": str(tmp_path)},
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    assert done.returncode == 1
    assert done.stderr.count("\n") == 1 and "no display" in done.stderr and "previs record" in done.stderr


def test_a_display_that_is_not_there_is_said_in_one_line(tmp_path: Path) -> None:
    environment = {k: v for k, v in os.environ.items() if k not in ("WAYLAND_DISPLAY", "PREVIS_WINDOW")}
    done = subprocess.run(
        [sys.executable, "-m", "previs.cli", "view"],
        env={**environment, "DISPLAY": ":987", "PREVIS_CONFIG": str(tmp_path)},
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    assert done.returncode == 1
    assert done.stderr.startswith("previs view: ") and done.stderr.count("\n") == 1, done.stderr
