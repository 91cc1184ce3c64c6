"""`previs info`, `diff` and `doctor`."""

import json
import os
import subprocess
import sys

import numpy as np
import pytest
from small_stages import CAMERA, LIGHT_AND_GROUND, usda, volume

from previs import Image, metrics
from previs.io import display, load_color


def picture(path, colour: np.ndarray) -> np.ndarray:
    colour = np.asarray(colour, np.float32)
    Image(colour, np.ones(colour.shape[:2], np.float32), np.ones(colour.shape[:2], np.float32)).save(path)
    return load_color(path)[0]


@pytest.fixture
def pair(tmp_path) -> tuple[np.ndarray, np.ndarray]:
    random = np.random.default_rng(2)
    reference = random.uniform(0.1, 0.8, (16, 20, 3))
    made = reference + random.normal(0.0, 0.02, reference.shape)
    return picture(tmp_path / "a.exr", made), picture(tmp_path / "b.exr", reference)


# --- info ---------------------------------------------------------------------------------------------------------


def test_info(run, stages):
    result = run("info", stages / "smoke.usda", "-w", 320, "--coefficients", 14)
    assert (result.returncode, result.stderr) == (0, "")
    lines = result.stdout.splitlines()
    for title in ("volumes (1)", "lights (1)", "meshes (1)", "cameras (2)", "plan for 320×180"):
        assert title in lines
    text = result.stdout
    for fact in (
        "/Smoke  density ",
        "active)",
        "from (-1.083, -1.083, -1.083) to (1.083, 1.083, 1.083)",
        "/Sun  distant, towards (",
        "irradiance 3 3 3",
        "/Ground  2 triangles",
        "/Cameras/Front  <- used",
    ):
        assert fact in text
    [march] = [line for line in lines if line.split()[:1] == ["march"]]
    assert "320×180" in march and "14 depths" in march
    assert any(line.startswith("  total") for line in lines)
    assert lines[-1] == "not shown as authored (0)"


def test_info_as_json(run, stages):
    result = run("info", stages / "smoke.usda", "--json", "-cam", "Top", "-w", 64)
    assert (result.returncode, result.stderr) == (0, "")
    told = json.loads(result.stdout)
    assert told["volumes"]["/Smoke"]["fields"]["density"]["grid"] == "density"
    assert told["volumes"]["/Smoke"]["medium"]["extinction"] == [4, 4, 4]
    assert told["lights"]["/Sun"]["kind"] == "distant"
    assert told["meshes"]["/Ground"] == {"triangles": 2, "instances": 1}
    assert told["cameras"] == ["/Cameras/Front", "/Cameras/Top"]
    assert (told["camera"], told["size"], told["notes"]) == ("/Cameras/Top", [64, 36], [])
    assert [p["pass"] for p in told["plan"]][-1] == "composite"
    assert all(p["why"] for p in told["plan"])


def test_info_says_what_is_not_shown_as_authored(run, stages):
    extra = 'def Points "Dust" { }' + 'def RectLight "Panel" { float inputs:intensity = 2 }'
    (stages / "odd.usda").write_text(usda(volume("ball.vdb") + LIGHT_AND_GROUND + CAMERA + extra))
    told = run("info", stages / "odd.usda").stdout.split("not shown as authored")[1]
    assert "/Dust: ignored: " in told
    assert "/Panel: approximated: " in told


def test_info_lists_what_cannot_be_read_with_the_rest(run, stages):
    result = run("info", "animated.usda", "--time", "2", cwd=stages)
    assert result.returncode == 0
    assert "missing: missing.vdb" in result.stdout.split("not shown as authored")[1]
    assert "plan for" in result.stdout


def test_purposes_mask_session_layer_and_time(run, stages):
    guide = (
        'def Cube "Guide" { uniform token purpose = "guide" }' + 'def Cube "Proxy" { uniform token purpose = "proxy" }'
    )
    guide += 'def Cube "Fine" { uniform token purpose = "render" }'
    light = 'def SphereLight "Bulb" { float inputs:intensity.timeSamples = ~ 1: 0, 2: 8, ! }'
    body = usda(guide + light).replace("~", "{").replace("!", "}")
    (stages / "purposes.usda").write_text(body)
    (stages / "hide.usda").write_text(usda('over "Fine" { token visibility = "invisible" }'))

    def info(*arguments):
        result = run("info", stages / "purposes.usda", "--json", *arguments)
        assert result.returncode == 0, result.stderr
        return json.loads(result.stdout)

    assert set(info("--time", 2)["meshes"]) == {"/Fine"}
    told = info("--purposes", "guide,proxy", "--mask", "/Guide,/Fine,/Bulb", "--time", 2)
    assert set(told["meshes"]) == {"/Guide"}
    assert set(told["lights"]) == {"/Bulb"}
    told = info("--sessionLayer", stages / "hide.usda", "--time", 1)
    assert not told["meshes"]
    assert told["lights"].get("/Bulb", {"strength": [0, 0, 0]})["strength"] == [0, 0, 0]


@pytest.mark.parametrize(
    ("arguments", "status", "piece"),
    [
        (["none.usda"], 1, "none.usda: no such file"),
        (["smoke.usda", "-cam", "Side"], 1, "/Cameras/Front, /Cameras/Top"),
        (["smoke.usda", "--coefficients", "5"], 2, "coefficients: '5'"),
        (["smoke.usda", "--time", "now"], 2, "--time"),
    ],
)
def test_info_of_bad_input(run, stages, arguments, status, piece):
    result = run("info", *arguments, cwd=stages)
    assert result.returncode == status
    [line] = result.stderr.splitlines()
    assert line.startswith("previs info: ") and piece in line


@pytest.mark.skipif(os.name != "posix", reason="pipes of POSIX")
@pytest.mark.parametrize("command", ["info", "doctor"])
def test_a_reader_that_goes_away(stages, command):
    reading, writing = os.pipe()
    os.close(reading)
    arguments = [stages / "smoke.usda"] if command == "info" else []
    result = subprocess.run(
        [sys.executable, "-m", "previs.cli", command, *arguments],
        stdout=writing,
        stderr=subprocess.PIPE,
        text=True,
        check=False,
    )
    os.close(writing)
    assert (result.returncode, result.stderr) == (1, "")


# --- diff ---------------------------------------------------------------------------------------------------------


def test_diff_gives_the_numbers_and_the_picture(run, tmp_path, pair):
    test, reference = pair
    result = run("diff", tmp_path / "a.exr", tmp_path / "b.exr", "--json", "-o", tmp_path / "d.exr")
    assert (result.returncode, result.stderr) == (0, "")
    told = json.loads(result.stdout)
    assert set(told) == {"rmse", "relative_rmse", "mean_relative_error", "psnr", "ssim", "flip"}
    for name in ("rmse", "relative_rmse", "mean_relative_error", "psnr", "ssim"):
        assert told[name] == pytest.approx(getattr(metrics, name)(test, reference), rel=1e-6)
    assert told["flip"] == pytest.approx(metrics.flip(test, reference, "HDR"), rel=1e-6)
    np.testing.assert_array_equal(load_color(tmp_path / "d.exr")[0], np.abs(test - reference))


def test_diff_in_words_and_a_picture_scaled_to_its_range(run, tmp_path, pair):
    result = run("diff", tmp_path / "a.exr", tmp_path / "b.exr", "--output", tmp_path / "d.png")
    assert (result.returncode, result.stderr) == (0, "")
    rows = dict((line[:20].strip(), line[20:].strip()) for line in result.stdout.splitlines())
    assert list(rows) == ["RMSE", "relative RMSE", "mean relative error", "PSNR", "SSIM", "FLIP"]
    assert rows["PSNR"] == f"{metrics.psnr(*pair):.2f} dB"
    assert load_color(tmp_path / "d.png")[0].max() == 1.0


def test_diff_of_display_pictures_and_of_small_ones(run, tmp_path, pair):
    picture(tmp_path / "a.png", pair[0])
    picture(tmp_path / "b.png", pair[1])
    told = json.loads(run("diff", tmp_path / "a.png", tmp_path / "b.png", "--json").stdout)
    shown = [np.round(display(p) * 255) / 255 for p in pair]
    assert told["rmse"] == pytest.approx(metrics.rmse(*shown), rel=1e-3)
    picture(tmp_path / "c.png", pair[0][:5])
    result = run("diff", tmp_path / "c.png", tmp_path / "c.png", "-o", tmp_path / "d.png")
    assert result.returncode == 0
    assert "PSNR                 inf dB" in result.stdout and "needs 11×11 pixels" in result.stdout
    assert load_color(tmp_path / "d.png")[0].max() == 0.0
    assert json.loads(run("diff", tmp_path / "c.png", tmp_path / "c.png", "--json").stdout)["psnr"] == "inf"


@pytest.mark.parametrize(
    ("test", "reference", "pieces"),
    [
        ("none.exr", "b.exr", ["none.exr: no such file"]),
        ("small.exr", "b.exr", ["small.exr is 20×5", "b.exr 20×16 pixels", "one size"]),
        ("a.png", "b.exr", ["a.png and b.exr: one is linear and one for display"]),
        ("text.png", "b.exr", ["text.png: cannot be read as a picture"]),
        ("b.exr", "nan.exr", ["nan.exr: 3 values are not finite"]),
    ],
)
def test_pictures_that_cannot_be_compared(run, tmp_path, pair, test, reference, pieces):
    picture(tmp_path / "small.exr", pair[0][:5])
    picture(tmp_path / "a.png", pair[0])
    (tmp_path / "text.png").write_text("hello")
    broken = pair[0].copy()
    broken[0, 0] = np.nan
    picture(tmp_path / "nan.exr", broken)
    result = run("diff", test, reference, "-o", "d.png", cwd=tmp_path)
    assert (result.returncode, result.stdout) == (1, "")
    [line] = result.stderr.splitlines()
    assert all(piece in line for piece in pieces)
    assert not (tmp_path / "d.png").exists()


# --- doctor -------------------------------------------------------------------------------------------------------


def test_doctor(run):
    result = run("doctor")
    assert (result.returncode, result.stderr) == (0, "")
    lines = result.stdout.splitlines()
    assert lines[0].startswith("Python 3.")
    for package in ("usd-core", "moderngl", "numpy", "openimageio", "blosc"):
        assert any(line.split()[0] == package and line.split()[1][0].isdigit() for line in lines)
    assert any(line.startswith("OpenGL ") and " on the " in line for line in lines)
    assert lines[-1] == "ready to render"


@pytest.mark.parametrize("command", ["view", "record", "info", "diff", "bench", "doctor"])
def test_help(command, capsys):
    from previs.cli import main

    with pytest.raises(SystemExit) as left:
        main([command, "--help"])
    assert left.value.code == 0
    assert f"usage: previs {command}" in capsys.readouterr().out


def test_version(run):
    result = run("--version")
    assert result.returncode == 0 and result.stdout.startswith("previs 0.")
