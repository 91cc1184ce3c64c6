"""What a program that uses previs has to load: no more than the job at hand needs."""

import subprocess
import sys
from pathlib import Path

import pytest

SCENES = Path(__file__).resolve().parents[2] / "scenes"

WINDOW = {"glfw", "imgui_bundle"}
#: Never needed to make a picture.
EXTRAS = WINDOW | {"matplotlib", "flip_evaluator", "unittest", "previs.bench", "previs.ui", "previs.reference"}
#: What costs most of the start where it is needed.
HEAVY = {"pxr", "moderngl", "OpenImageIO", "blosc"}


def loaded(program: str, *arguments: str) -> set[str]:
    """The modules that a Python program has loaded when it ends, by whatever way it ends."""
    report = "import atexit, sys; atexit.register(lambda: print('\\n' + ' '.join(sys.modules)));"
    done = subprocess.run([sys.executable, "-c", report + program, *arguments], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return set(done.stdout.splitlines()[-1].split())


def command(*arguments: str) -> set[str]:
    return loaded("from previs.cli import main; sys.exit(main(sys.argv[1:]))", *arguments)


def test_previs_alone_loads_next_to_nothing():
    modules = loaded("import previs")
    assert not modules & (EXTRAS | HEAVY | {"numpy", "dataclasses"})
    assert "previs" in modules


@pytest.mark.parametrize(
    ("name", "module"),
    [("Settings", "previs.settings"), ("Scene", "previs.scene"), ("Renderer", "previs.render.renderer")],
)
def test_a_public_name_brings_its_module(name, module):
    assert module in loaded(f"import previs; previs.{name}")


def test_the_function_render_is_not_covered_by_the_package():
    assert "moderngl" in loaded(
        "import previs, previs.render.renderer, previs.render.plan; from previs import render;"
        "assert callable(previs.render) and render is previs.render"
    )


def test_a_scene_needs_no_opengl():
    assert not loaded("import previs; previs.Scene().close()") & (EXTRAS | {"moderngl", "OpenImageIO", "blosc"})


@pytest.mark.parametrize("arguments", [("--help",), ("view", "--help"), ("--version",)])
def test_help_loads_no_library(arguments):
    assert not command(*arguments) & (EXTRAS | HEAVY | {"numpy"})


def test_help_of_a_command_loads_no_other_command():
    modules = command("record", "--help")
    assert not modules & (EXTRAS | HEAVY)
    assert {m for m in modules if m.startswith("previs.commands.")} >= {"previs.commands.record"}
    assert not {m for m in modules if m.startswith("previs.commands.")} & {
        f"previs.commands.{name}" for name in ("view", "info", "diff", "bench", "doctor")
    }


def test_info_needs_neither_opengl_nor_picture_files():
    modules = command("info", str(SCENES / "plume.usda"))
    assert "pxr.Usd" in modules
    assert not modules & (EXTRAS | {"moderngl", "OpenImageIO", "blosc"})


@pytest.mark.gl
def test_record_loads_only_what_draws_and_writes(tmp_path):
    picture = tmp_path / "plume.png"
    modules = command("record", str(SCENES / "plume.usda"), str(picture), "-w", "32", "--steps", "4")
    assert picture.is_file()
    assert {"pxr.Usd", "moderngl", "OpenImageIO"} <= modules
    assert not modules & (EXTRAS | {"blosc", "previs.render.measure", "previs.render.osmesa", "previs.vdb.writer"})
