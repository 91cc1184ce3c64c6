"""Bad input: one line on stderr that names the file or the prim, the right exit status, no half-written picture."""

import json
from pathlib import Path

import numpy as np
import pytest
from small_stages import CAMERA, LIGHT_AND_GROUND, ball, usda, volume

from previs import vdb
from previs.io import load_color

LIT = LIGHT_AND_GROUND + CAMERA
NO_GL = {
    "PREVIS_GL": "egl",
    "GLCONTEXT_LINUX_LIBGL": "/nowhere/libGL.so",
    "GLCONTEXT_LINUX_LIBEGL": "/nowhere/libEGL.so",
}


@pytest.fixture(scope="module")
def bad(tmp_path_factory) -> Path:
    """A folder of files that are wrong in one way each; `good.usda` is not."""
    folder = tmp_path_factory.mktemp("bad")
    transform = np.diag([2 / 12, 2 / 12, 2 / 12, 1.0])
    transform[3, :3] = -1.0 + 1 / 12

    def grid(name: str, values: np.ndarray) -> None:
        vdb.write(folder / name, [vdb.Grid.from_dense("density", values.astype(np.float32), transform)])

    grid("ball.vdb", ball())
    grid("empty.vdb", np.zeros((4, 4, 4)))
    spoilt = ball()
    spoilt[4, 4, 4], spoilt[5, 5, 5], spoilt[6, 6, 6] = np.nan, np.inf, -3.0
    grid("spoilt.vdb", spoilt)
    whole = (folder / "ball.vdb").read_bytes()
    (folder / "cut.vdb").write_bytes(whole[: len(whole) // 2])
    (folder / "noise.vdb").write_bytes(np.random.default_rng(0).bytes(4096))
    (folder / "zero.vdb").write_bytes(b"")
    (folder / "folder.vdb").mkdir()
    (folder / "folder.usda").mkdir()
    (folder / "notes.txt").write_text("hello")
    (folder / "broken.usda").write_text("#usda 1.0\ndef Xform {")
    (folder / "empty.usda").write_text("")
    (folder / "noise.usdc").write_bytes(b"PXR-USDC" + np.random.default_rng(0).bytes(500))
    (folder / "noise.usdz").write_bytes(np.random.default_rng(0).bytes(500))
    for name in ("missing", "cut", "noise", "zero", "folder"):
        (folder / f"{name}_vdb.usda").write_text(usda(volume(f"{name}.vdb") + LIT))
    (folder / "no_path.usda").write_text(usda(volume("").replace("asset filePath = @@", "") + LIT))
    (folder / "wrong_grid.usda").write_text(usda(volume("ball.vdb", grid="smoke") + LIT))
    (folder / "dangling.usda").write_text(usda('def Volume "V" { rel field:density = </V/none> }' + LIT))
    (folder / "no_extent.usda").write_text(usda('def Volume "V" { }' + LIT))
    (folder / "good.usda").write_text(usda(volume("ball.vdb") + LIT))
    twins = "".join(f'def Xform "{x}" {{ {CAMERA} }}' for x in "AB")
    (folder / "twins.usda").write_text(usda(volume("ball.vdb") + LIGHT_AND_GROUND + twins))
    (folder / "resolution.usda").write_text(
        usda(volume("ball.vdb") + LIT + 'def RenderSettings "R" { int2 resolution = (0, 10) }')
    )
    return folder


#: (name, stage, further arguments, what the line must hold). {bad} is the folder.
CANNOT_RENDER = [
    ("no stage", "none.usda", "", ["{bad}/none.usda: no such file"]),
    ("folder for stage", "folder.usda", "", ["{bad}/folder.usda: is a folder"]),
    ("text for stage", "notes.txt", "", ["{bad}/notes.txt: not a USD file", ".usda"]),
    ("broken usda", "broken.usda", "", ["{bad}/broken.usda: cannot be read as USD"]),
    ("empty usda", "empty.usda", "", ["{bad}/empty.usda: cannot be read as USD"]),
    ("broken usdc", "noise.usdc", "", ["{bad}/noise.usdc: cannot be read as USD"]),
    ("broken usdz", "noise.usdz", "", ["{bad}/noise.usdz: cannot"]),
    ("no vdb", "missing_vdb.usda", "", ["/Smoke/density", "missing.vdb: no such file"]),
    ("half a vdb", "cut_vdb.usda", "", ["/Smoke/density", "cut.vdb"]),
    ("noise for vdb", "noise_vdb.usda", "", ["/Smoke/density", "noise.vdb: not a readable .vdb file"]),
    ("vdb of no bytes", "zero_vdb.usda", "", ["/Smoke/density", "zero.vdb: not a readable .vdb file"]),
    ("folder for vdb", "folder_vdb.usda", "", ["/Smoke/density", "folder.vdb"]),
    ("no filePath", "no_path.usda", "", ["/Smoke/density", "filePath"]),
    ("wrong fieldName", "wrong_grid.usda", "", ["/Smoke/density", "ball.vdb: no grid named smoke", "density"]),
    ("field that is not there", "dangling.usda", "", ["/V: field:density points to /V/none"]),
    ("neither field nor extent", "no_extent.usda", "", ["/V: ", "field:density or extent"]),
    ("unknown camera", "good.usda", "-cam Other", ["Other: no such camera", "/Cam"]),
    ("unknown camera path", "good.usda", "-cam /Smoke", ["/Smoke: no such camera", "/Cam"]),
    ("two cameras of a name", "twins.usda", "-cam Cam", ["Cam: several cameras", "/A/Cam, /B/Cam"]),
    ("unknown mask", "good.usda", "--mask /Nothing", ["no prim at /Nothing"]),
    ("malformed mask", "good.usda", "--mask no.path", ["no.path: not a prim path"]),
    ("no session layer", "good.usda", "--sessionLayer {bad}/none.usda", ["{bad}/none.usda: no such file"]),
    ("bad session layer", "good.usda", "--sessionLayer {bad}/broken.usda", ["{bad}/broken.usda: cannot be read"]),
    ("no RenderSettings", "good.usda", "-rs /Cam", ["/Cam: not a RenderSettings prim"]),
    ("too wide", "good.usda", "-w 1000000", ["image of 1000000×"]),
    ("no folder for stats", "good.usda", "--stats {bad}/none/s.json", ["{bad}/none/s.json: there is no folder"]),
]

#: (name, arguments after `record`, what the line must hold)
WRONG_ARGUMENTS = [
    ("nothing", [], ["STAGE", "OUTPUT"]),
    ("no output", ["s.usda"], ["OUTPUT"]),
    ("unknown option", ["s.usda", "a.png", "--wdith", "3"], ["--wdith"]),
    ("no width", ["s.usda", "a.png", "-w", "0"], ["--imageWidth", "0 is not a whole number of 1 or more"]),
    ("width in words", ["s.usda", "a.png", "-w", "wide"], ["--imageWidth", "wide"]),
    ("bad frames", ["s.usda", "a.#.png", "-f", "1-10"], ["'1-10'", "FIRST:LASTxSTRIDE"]),
    ("no frames", ["s.usda", "a.#.png", "-f", ""], ["FIRST:LASTxSTRIDE"]),
    ("frames in one file", ["s.usda", "a.png", "-f", "1:3"], ["a.png: 3 frames need a ###"]),
    ("frames that meet in one name", ["s.usda", "a.#.png", "-f", "1:2x0.5"], ["a.#.png", "###.###"]),
    ("frames and default time", ["s.usda", "a.#.png", "-f", "1", "-d"], ["--defaultTime", "--frames"]),
    ("odd coefficients", ["s.usda", "a.png", "--coefficients", "7"], ["coefficients: '7' is not an even number"]),
    ("unknown method", ["s.usda", "a.png", "--transmittance", "exact"], ["transmittance: 'exact'", "tfm-plain"]),
    ("bad value", ["s.usda", "a.png", "--set", "steps=none"], ["steps: 'none' is not 0 or a whole number"]),
    ("value out of range", ["s.usda", "a.png", "--set", "antialias=0"], ["antialias: '0'", "from 1 to"]),
    ("unknown knob", ["s.usda", "a.png", "--set", "stepz=3"], ["no knob 'stepz'", "map_size"]),
    ("no value", ["s.usda", "a.png", "--set", "steps"], ["--set steps: write NAME=VALUE"]),
    ("bad exposure", ["s.usda", "a.png", "--exposure", "bright"], ["--exposure", "'bright'", "auto"]),
    ("exposure beyond floats", ["s.usda", "a.png", "--exposure", "3000"], ["--exposure", "from -64 to 64"]),
    ("unknown correction", ["s.usda", "a.png", "-color", "srgb"], ["--colorCorrectionMode", "openColorIO"]),
    ("unknown purpose", ["s.usda", "a.png", "--purposes", "draft"], ["--purposes", "draft", "guide"]),
]


def one_line(result, status: int, pieces: list[str]) -> None:
    assert result.returncode == status, result.stderr
    assert result.stdout == ""
    [line] = result.stderr.splitlines()
    assert line.startswith("previs")
    for piece in pieces:
        assert piece in line


@pytest.mark.parametrize(
    ("stage", "arguments", "pieces"), [c[1:] for c in CANNOT_RENDER], ids=[c[0] for c in CANNOT_RENDER]
)
def test_what_cannot_be_rendered(run, bad, tmp_path, stage, arguments, pieces):
    output = tmp_path / "a.png"
    output.write_bytes(b"good")
    given = ("-w", 16, *arguments.format(bad=bad).split())
    one_line(run("record", bad / stage, output, *given), 1, [p.format(bad=bad) for p in pieces])
    assert output.read_bytes() == b"good"
    assert list(tmp_path.iterdir()) == [output]


@pytest.mark.parametrize(("arguments", "pieces"), [c[1:] for c in WRONG_ARGUMENTS], ids=[c[0] for c in WRONG_ARGUMENTS])
def test_wrong_arguments(arguments, pieces, capsys, tmp_path, monkeypatch):
    """In this process: they are refused before anything is opened."""
    from previs.cli import main

    monkeypatch.chdir(tmp_path)
    try:
        status = main(["record", *arguments])
    except SystemExit as left:
        status = left.code
    assert status == 2
    out, err = capsys.readouterr()
    assert out == ""
    [line] = err.splitlines()
    assert line.startswith("previs record: ")
    for piece in pieces:
        assert piece in line
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("output", "piece"),
    [
        ("none/a.png", "none/a.png: there is no folder"),
        ("a.tiff", "a.tiff: no format ends in '.tiff'"),
        ("a", "a: its name has no ending; use one of .exr"),
        ("folder.png", "folder.png: cannot be written"),
    ],
)
def test_outputs_that_cannot_be_written(run, bad, tmp_path, output, piece):
    (tmp_path / "folder.png").mkdir()
    one_line(run("record", bad / "good.usda", output, "-w", 16, cwd=tmp_path), 1, [piece])
    assert [p.name for p in tmp_path.iterdir()] == ["folder.png"]


def test_an_empty_resolution(run, bad, tmp_path):
    one_line(run("record", bad / "resolution.usda", tmp_path / "a.png"), 1, ["/R: a resolution of (0, 10)"])
    assert not list(tmp_path.iterdir())


def test_no_command_and_an_unknown_one(run):
    for arguments in ((), ("rekord",)):
        one_line(run(*arguments), 2, ["record"])


def test_a_missing_opencolorio_config(run, bad, tmp_path):
    result = run("record", bad / "good.usda", tmp_path / "a.png", "-w", 16, "-color", "openColorIO",
                 environment={"OCIO": "/nowhere.ocio"})  # fmt: skip
    one_line(result, 1, ["OpenColorIO config /nowhere.ocio"])
    assert not list(tmp_path.iterdir())


def test_no_opengl(run, bad, tmp_path):
    """The error names the packages, as does doctor; info needs no OpenGL."""
    result = run("record", bad / "good.usda", tmp_path / "a.png", environment=NO_GL)
    one_line(result, 1, ["OpenGL 3.3 is not available", "libGL.so", "apt-get install", "libegl1", "libgl1"])
    assert not list(tmp_path.iterdir())
    result = run("doctor", environment=NO_GL)
    assert result.returncode == 1
    assert "OpenGL: no" in result.stdout and "libegl1" in result.stdout
    assert "Traceback" not in result.stderr
    assert run("info", bad / "good.usda", environment=NO_GL).returncode == 0


def warned(run, bad, tmp_path, body: str, *arguments: object) -> tuple[list[str], np.ndarray]:
    """Warnings of a stage that renders all the same, which are those of --stats, and its picture."""
    (bad / "case.usda").write_text(usda(body))
    stats, output = tmp_path / "s.json", tmp_path / "a.exr"
    result = run("record", bad / "case.usda", output, "-w", 32, "--stats", stats, *arguments)
    assert result.returncode == 0, result.stderr
    [frame] = json.loads(stats.read_text())["frames"]
    assert result.stderr.splitlines() == [f"warning: {w}" for w in frame["warnings"]]
    colour, _ = load_color(output)
    assert np.isfinite(colour).all()
    return frame["warnings"], colour


def test_a_stage_with_nothing_in_it(run, bad, tmp_path):
    [warning], colour = warned(run, bad, tmp_path, "")
    assert "nothing to show" in warning
    assert not colour.any()


def test_no_light(run, bad, tmp_path):
    [warning], colour = warned(run, bad, tmp_path, volume("ball.vdb") + CAMERA)
    assert "no light" in warning and "--cameraLight" in warning
    assert not colour.any()


def test_no_camera(run, bad, tmp_path):
    warnings, colour = warned(run, bad, tmp_path, volume("ball.vdb") + LIGHT_AND_GROUND.split("def Mesh")[0])
    assert warnings == []
    # The whole stage is in view, with something left around it.
    lit = colour.max(axis=-1) > 0.0
    assert 0.05 < lit.mean() < 0.95
    assert not lit[0].any() and not lit[-1].any()


def test_an_empty_grid(run, bad, tmp_path):
    [warning], colour = warned(run, bad, tmp_path, volume("empty.vdb") + LIT)
    assert warning.startswith("/Smoke/density: empty: ")
    assert colour.any(), "the ground is there"


def test_voxels_that_are_no_densities(run, bad, tmp_path):
    [warning], colour = warned(run, bad, tmp_path, volume("spoilt.vdb") + LIT)
    assert warning.startswith("/Smoke/density: repaired: 1 NaN, 1 infinite, 1 negative")
    assert colour.any()


@pytest.mark.parametrize(
    "body",
    [
        'def Volume "Flat" { float3[] extent = [(0, 0, 0), (1, 0, 1)] }',
        volume(
            "ball.vdb",
            "Flat",
            extra='float3 xformOp:scale = (1, 0, 1)\n uniform token[] xformOpOrder = ["xformOp:scale"]',
        ),
    ],
    ids=["extent", "transform"],
)
def test_a_volume_without_thickness(run, bad, tmp_path, body):
    [warning], colour = warned(run, bad, tmp_path, body + LIT)
    assert warning.startswith("/Flat: empty: ") and "no thickness" in warning
    assert colour.any()
