"""`previs record`: pictures in files, as usdrecord's users expect them."""

import importlib.metadata
import json
import signal
import subprocess
import sys
from dataclasses import replace

import numpy as np
import OpenImageIO as oiio
import pytest
from small_stages import CAMERA, LIGHT_AND_GROUND, usda, volume

import previs
from previs import vdb
from previs.io import display, load_color
from previs.settings import TABLE

WIDTH = 64


def channels(path) -> dict[str, np.ndarray]:
    buffer = oiio.ImageBuf(str(path))
    pixels = buffer.get_pixels(oiio.FLOAT)
    return {name: pixels[..., i] for i, name in enumerate(buffer.spec().channelnames)}


@pytest.fixture(scope="module")
def expected(stages) -> previs.Image:
    return previs.render(stages / "smoke.usda", "/Cameras/Front", WIDTH)


def ok(result: subprocess.CompletedProcess[str]) -> subprocess.CompletedProcess[str]:
    assert (result.returncode, result.stderr) == (0, "")
    return result


def test_the_command_is_installed():
    [entry] = importlib.metadata.entry_points(group="console_scripts", name="previs")
    from previs.cli import main

    assert entry.load() is main


def test_exr_and_stats(run, stages, tmp_path, expected):
    """The planes of the contract with the values of the API, and everything that is known about the frame."""
    ok(run("record", stages / "smoke.usda", tmp_path / "a.exr", "-w", WIDTH, "--stats", tmp_path / "a.json"))
    stored = channels(tmp_path / "a.exr")
    planes = {f"{p}.{c}" for p in ("albedo", "transmittance", "volume", "emission") for c in "RGB"}
    assert set(stored) == {*"RGBAZ", *planes, "normal.X", "normal.Y", "normal.Z"}
    assert stored["R"].shape == (36, WIDTH)
    for i, c in enumerate("RGB"):
        np.testing.assert_array_equal(stored[c], expected.color[..., i])
    np.testing.assert_array_equal(stored["A"], expected.alpha)
    np.testing.assert_array_equal(stored["Z"], expected.depth)
    for name, plane in expected.aovs.items():
        for i, c in enumerate("XYZ" if name == "normal" else "RGB"):
            np.testing.assert_array_equal(stored[f"{name}.{c}"], plane[..., i])
    assert stored["emission.R"].max() > 0.0

    told = json.loads((tmp_path / "a.json").read_text())
    assert told["stage"] == str(stages / "smoke.usda")
    [frame] = told["frames"]
    assert frame["file"] == str(tmp_path / "a.exr")
    assert (frame["frame"], frame["camera"], frame["size"]) == (None, "/Cameras/Front", [WIDTH, 36])
    assert frame["warnings"] == []
    assert frame["settings"] == {s.name: s.default for s in TABLE}
    names = [p["pass"] for p in frame["plan"]]
    assert {"march", "composite", "gbuffer", "transmittance_map /Sun > /Smoke"} <= set(names)
    assert all(p["why"] and p["bytes"] >= 0 for p in frame["plan"])
    assert frame["executed"] == names
    assert set(frame["times"]) == set(names)
    assert all(t >= 0.0 for t in frame["times"].values())
    assert frame["memory"] == sum(p["bytes"] for p in frame["plan"]) > 0
    assert 0.0 < frame["seconds"] <= frame["total_seconds"]
    assert frame["device"]


@pytest.mark.parametrize("ending", ["png", "jpg"])
def test_display_formats(run, stages, tmp_path, expected, ending):
    ok(run("record", stages / "smoke.usda", tmp_path / f"a.{ending}", "--imageWidth", WIDTH))
    stored, linear = load_color(tmp_path / f"a.{ending}")
    assert not linear
    np.testing.assert_allclose(stored, display(expected.color), atol={"png": 0.51 / 255, "jpg": 0.2}[ending])
    assert [p.name for p in tmp_path.iterdir()] == [f"a.{ending}"]


@pytest.mark.parametrize("mode", ["disabled", "sRGB", "openColorIO"])
def test_colour_correction_and_exposure(run, stages, tmp_path, expected, mode):
    ok(run("record", stages / "smoke.usda", tmp_path / "a.png", "-w", WIDTH, "-color", mode, "--exposure", "auto"))
    stored, _ = load_color(tmp_path / "a.png")
    np.testing.assert_allclose(stored, display(expected.color, "auto", mode), atol=0.51 / 255)


def test_exposure_in_stops_acts_on_display_formats_only(run, stages, tmp_path, expected):
    ok(run("record", stages / "smoke.usda", tmp_path / "a.png", "-w", WIDTH, "--exposure", "-1.5"))
    ok(run("record", stages / "smoke.usda", tmp_path / "a.exr", "-w", WIDTH, "--exposure", "-1.5"))
    np.testing.assert_allclose(load_color(tmp_path / "a.png")[0], display(expected.color, -1.5), atol=0.51 / 255)
    np.testing.assert_array_equal(load_color(tmp_path / "a.exr")[0], expected.color)


# --- frames -------------------------------------------------------------------------------------------------------


def test_a_frame_that_fails_stops_no_other(run, stages, tmp_path):
    """Frames counted down; the good file of an earlier run stays where the new frame fails."""
    (tmp_path / "f.0002.png").write_bytes(b"good")
    result = run(
        "record",
        stages / "animated.usda",
        tmp_path / "f.####.png",
        "-f",
        "3:1",
        "-w",
        32,
        "--stats",
        tmp_path / "s.json",
    )
    assert result.returncode == 1
    [line] = result.stderr.splitlines()
    assert line.startswith("previs record: frame 2: ")
    assert "missing.vdb" in line
    assert [line.split()[3] for line in result.stdout.splitlines()] == ["3.0000", "1.0000"]
    assert sorted(p.name for p in tmp_path.iterdir()) == ["f.0001.png", "f.0002.png", "f.0003.png", "s.json"]
    assert (tmp_path / "f.0002.png").read_bytes() == b"good"
    np.testing.assert_array_equal(load_color(tmp_path / "f.0001.png")[0], load_color(tmp_path / "f.0003.png")[0])
    frames = json.loads((tmp_path / "s.json").read_text())["frames"]
    assert [f["frame"] for f in frames] == [3, 2, 1]
    assert "missing.vdb" in frames[1]["error"]
    assert "error" not in frames[0]
    assert frames[2]["file"].endswith("f.0001.png")


def test_a_picture_that_cannot_be_written_stops_no_other(run, stages, tmp_path):
    """Writing goes on beside the next frame; the failure is said of its own frame, and in the order of the frames."""
    stats = tmp_path / "s.json"
    frames = ("-f", "3,1,2,1.2", "-w", 32, "--stats", stats, "--no-measure-error")
    (tmp_path / "f.0001.20.png").mkdir()
    result = run("record", stages / "animated.usda", tmp_path / "f.####.##.png", *frames)
    assert result.returncode == 1
    said = result.stderr.splitlines()
    assert [line.split(": ")[1] for line in said] == ["frame 2", "frame 1.2"]
    assert "f.0001.20.png: cannot be written" in said[1]
    records = json.loads(stats.read_text())["frames"]
    assert [(r["frame"], "error" in r) for r in records] == [(3, False), (1, False), (2, True), (1.2, True)]
    assert not [p.name for p in tmp_path.iterdir() if p.name.startswith(".")]


def test_only_what_changed_is_drawn_again(run, stages, tmp_path):
    """Other voxels: no new G-buffer; the same voxels under another name of the time: nothing at all."""
    ball = vdb.read(stages / "ball.vdb")
    vdb.write(tmp_path / "a.vdb", ball)
    vdb.write(tmp_path / "b.vdb", [replace(g, leaf_values=g.leaf_values * 0.5) for g in ball])
    timed = "asset filePath.timeSamples = { 1: @a.vdb@, 2: @b.vdb@, 3: @b.vdb@, }"
    text = volume("a.vdb").replace("asset filePath = @a.vdb@", timed)
    (tmp_path / "s.usda").write_text(usda(LIGHT_AND_GROUND + CAMERA) + text)
    frames = ("-f", "1:3", "-w", 32, "--stats", tmp_path / "s.json", "--no-measure-error")
    ok(run("record", tmp_path / "s.usda", tmp_path / "f.#.png", *frames))
    first, second, third = (f["executed"] for f in json.loads((tmp_path / "s.json").read_text())["frames"])
    assert {"fields", "gbuffer", "march", "composite"} <= set(first)
    assert {"fields", "march", "composite"} <= set(second)
    assert "gbuffer" not in second
    assert third == []


def test_strides_fractions_and_decimals(run, stages, tmp_path):
    ok(run("record", stages / "animated.usda", tmp_path / "f_###.##.exr", "--frames", "1:1.5x0.25,3", "-w", 16))
    assert sorted(p.name for p in tmp_path.iterdir()) == [
        f"f_{n}.exr" for n in ("001.00", "001.25", "001.50", "003.00")
    ]


def test_default_time(run, stages, tmp_path):
    ok(run("record", stages / "smoke.usda", tmp_path / "a.png", "--defaultTime", "-w", 16))
    assert (tmp_path / "a.png").is_file()


def test_stopping_leaves_only_whole_pictures(stages, tmp_path):
    command = [sys.executable, "-m", "previs.cli", "record", str(stages / "smoke.usda"), str(tmp_path / "f.####.exr")]
    with subprocess.Popen(
        [*command, "-f", "1:5000", "-w", "32"], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as process:
        assert process.stdout.readline().startswith("Recording time code: 1.0000")
        process.send_signal(signal.SIGINT)
        _, said = process.communicate(timeout=60)
    assert process.returncode == 130
    assert said == "stopped\n"
    written = sorted(tmp_path.iterdir())
    assert 1 <= len(written) < 5000
    for path in written:
        assert path.name.startswith("f.")
        assert load_color(path)[0].shape == (18, 32, 3)


# --- what is rendered ---------------------------------------------------------------------------------------------


def test_cameras_by_path_and_by_name(run, stages, tmp_path):
    ok(run("record", stages / "smoke.usda", tmp_path / "a.exr", "-w", 32, "--camera", "/Cameras/Top"))
    ok(run("record", stages / "smoke.usda", tmp_path / "b.exr", "-w", 32, "-cam", "Top"))
    top = previs.render(stages / "smoke.usda", "Top", 32).color
    np.testing.assert_array_equal(load_color(tmp_path / "a.exr")[0], top)
    np.testing.assert_array_equal(load_color(tmp_path / "b.exr")[0], top)


def test_every_flag_of_the_table_and_set(run, stages, tmp_path):
    flags = {"transmittance": "tfm-plain", "coefficients": "14", "steps": "40", "map_size": "64", "march_divisor": "2"}
    assert {s.name for s in TABLE if s.flag} == set(flags), "a new flag wants a value here"
    arguments = [text for s in TABLE if s.flag for text in (s.flag, flags[s.name])]
    others = {"threshold": 0.02, "antialias": 2, "map_filter": "nearest", "projective_steps": False}
    arguments += [text for name, value in others.items() for text in ("--set", f"{name}={value}")]
    ok(run("record", stages / "smoke.usda", tmp_path / "a.exr", "-w", 32, "--stats", tmp_path / "s.json", *arguments))
    [frame] = json.loads((tmp_path / "s.json").read_text())["frames"]
    asked = {n: type(frame["settings"][n])(v) for n, v in flags.items()} | others
    assert frame["settings"] == {s.name: s.default for s in TABLE} | asked
    image = previs.render(stages / "smoke.usda", size=32, **flags, **others)
    np.testing.assert_array_equal(load_color(tmp_path / "a.exr")[0], image.color)


def test_reference_is_a_brute_force_march(run, stages, tmp_path):
    """At least 1024 steps, and two per voxel of a grid that is longer than that; light goes from voxel to voxel."""
    vdb.write(stages / "long.vdb", [vdb.Grid.from_dense("density", np.ones((900, 1, 1), np.float32))])
    (stages / "long.usda").write_text(usda(volume("long.vdb") + LIGHT_AND_GROUND + CAMERA))
    asked = ("-w", 8, "--reference", "--stats", tmp_path / "s.json")
    for stage, least in (("smoke", 1024), ("long", 1800)):
        ok(run("record", stages / f"{stage}.usda", tmp_path / "a.exr", *asked))
        settings = json.loads((tmp_path / "s.json").read_text())["frames"][0]["settings"]
        assert settings["transmittance"] == "march"
        assert least <= settings["steps"] < 1.1 * least
        assert settings["light_steps"] == 0


def test_accepted_for_usdrecord(run, stages, tmp_path):
    """Options without effect here take their values and change nothing."""
    accepted = ("--disableCameraLight", "--complexity", "high", "--enableDomeLightVisibility", "--disableGpu")
    ok(run("record", stages / "smoke.usda", tmp_path / "a.exr", "-w", 32, *accepted))
    plain = previs.render(stages / "smoke.usda", size=32).color
    np.testing.assert_array_equal(load_color(tmp_path / "a.exr")[0], plain)


def test_dome_light_behind_the_media(run, stages, tmp_path):
    (stages / "dome.usda").write_text(
        usda('def DomeLight "Sky" { color3f inputs:color = (0.1, 0.2, 0.4) }' + volume("ball.vdb") + CAMERA)
    )
    run("record", stages / "dome.usda", tmp_path / "off.exr", "-w", 32)
    assert (
        run("record", stages / "dome.usda", tmp_path / "on.exr", "-w", 32, "--enableDomeLightVisibility").returncode
        == 0
    )
    off, on = channels(tmp_path / "off.exr"), channels(tmp_path / "on.exr")
    assert off["B"][0, 0] == 0.0
    np.testing.assert_allclose([on[c][0, 0] for c in "RGB"], (0.1, 0.2, 0.4), rtol=1e-6)
    transmitted = off["transmittance.B"] * 0.4
    np.testing.assert_allclose(on["B"] - off["B"], transmitted, atol=1e-6)
    assert transmitted.min() < 0.2, "the ball hides some of it"


def test_camera_light(run, stages, tmp_path):
    (stages / "unlit.usda").write_text(usda(volume("ball.vdb") + CAMERA))
    result = run("record", stages / "unlit.usda", tmp_path / "dark.exr", "-w", 32, "--stats", tmp_path / "s.json")
    assert result.returncode == 0
    assert result.stderr == "warning: the stage has no light, so nothing is lit; --cameraLight adds one\n"
    assert json.loads((tmp_path / "s.json").read_text())["frames"][0]["warnings"] == [result.stderr[9:-1]]
    ok(run("record", stages / "unlit.usda", tmp_path / "lit.exr", "-w", 32, "--cameraLight"))
    assert load_color(tmp_path / "dark.exr")[0].max() == 0.0
    assert load_color(tmp_path / "lit.exr")[0].max() > 0.1


def test_render_settings_mask_and_session_layer(run, stages, tmp_path):
    """The picture follows the RenderSettings, the session layer's edit and the mask, all at once."""
    body = """
def RenderSettings "Low" { int2 resolution = (40, 30)
    rel camera = </Wide> }
def RenderSettings "Other" { int2 resolution = (8, 8) }
def Camera "Wide" { float focalLength = 20
    double3 xformOp:translate = (0, 0, 8)
    uniform token[] xformOpOrder = ["xformOp:translate"] }
"""
    (stages / "settings.usda").write_text(usda(volume("ball.vdb") + LIGHT_AND_GROUND + CAMERA + body))
    (stages / "edit.usda").write_text(usda('over "Sun" { float inputs:intensity = 0 }'))
    plain = ("record", stages / "settings.usda", tmp_path / "a.exr", "-rs", "/Low", "--stats", tmp_path / "s.json")
    ok(run(*plain))
    [frame] = json.loads((tmp_path / "s.json").read_text())["frames"]
    assert (frame["camera"], frame["size"]) == ("/Wide", [40, 30])
    stored = channels(tmp_path / "a.exr")
    assert stored["R"].shape == (30, 40)
    assert np.isfinite(stored["Z"]).any()
    mask = ("--mask", "/Smoke,/Sun,/Wide,/Low", "--sessionLayer", stages / "edit.usda")
    result = run(*plain, *mask)
    assert result.returncode == 0
    assert "no light" in result.stderr
    stored = channels(tmp_path / "a.exr")
    assert "Z" in stored and np.isinf(stored["Z"]).all(), "the ground is not in the mask"
    assert stored["A"].max() > 0.5, "the smoke is"
    assert stored["R"].max() == 0.0, "the session layer put the sun out"


def test_keep_going_leaves_a_volume_out(run, stages, tmp_path):
    (stages / "half.usda").write_text(usda(volume("ball.vdb") + volume("gone.vdb", "Gone") + LIGHT_AND_GROUND + CAMERA))
    result = run("record", stages / "half.usda", tmp_path / "a.exr", "-w", 32)
    assert result.returncode == 1 and "gone.vdb" in result.stderr
    assert not (tmp_path / "a.exr").exists()
    stats = tmp_path / "s.json"
    result = run("record", stages / "half.usda", tmp_path / "a.exr", "-w", 32, "--keepGoing", "--stats", stats)
    assert result.returncode == 0
    [warning] = [line for line in result.stderr.splitlines() if "gone.vdb" in line]
    assert warning.startswith("warning: ") and "left out" in warning
    assert any("gone.vdb" in w for w in json.loads(stats.read_text())["frames"][0]["warnings"])
    assert channels(tmp_path / "a.exr")["A"].max() > 0.5


def test_a_warning_is_said_once_for_all_frames(run, stages, tmp_path):
    (stages / "dark.usda").write_text(usda(volume("ball.vdb") + CAMERA))
    result = run(
        "record", stages / "dark.usda", tmp_path / "a.#.png", "-f", "1:4", "-w", 16, "--stats", tmp_path / "s.json"
    )
    assert result.returncode == 0
    assert len(result.stderr.splitlines()) == 1
    assert all(len(f["warnings"]) == 1 for f in json.loads((tmp_path / "s.json").read_text())["frames"])
