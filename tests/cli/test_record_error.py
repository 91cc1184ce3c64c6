"""`previs record` says how far its pictures are from the truth."""

import json

import OpenImageIO as oiio
import pytest

import previs

WIDTH = 48


def test_the_error_is_printed_and_stored(run, stages, tmp_path):
    """In one line, in the statistics, and in the metadata of the picture; the same as by the API."""
    stats, output = tmp_path / "a.json", tmp_path / "a.exr"
    result = run("record", stages / "smoke.usda", output, "-w", WIDTH, "--stats", stats, "--set", "error_pixels=64")
    assert (result.returncode, result.stderr) == (0, "")
    [line] = [x for x in result.stdout.splitlines() if "PSNR" in x]
    assert line.startswith(f"{output}: mean error ") and "64 pixels" in line
    [frame] = json.loads(stats.read_text())["frames"]
    error = frame["measured_error"]
    assert error["pixels"] == 64
    assert error["relative_rmse"]["low"] <= error["relative_rmse"]["value"] <= error["relative_rmse"]["high"]
    spec = oiio.ImageBuf(str(output)).spec()
    for name in ("relative_rmse", "mean_relative_error", "psnr"):
        for key, value in error[name].items():
            assert spec.getattribute(f"previs:error:{name}:{key}") == pytest.approx(value)
    stored = spec.getattribute("previs:error:light:mean_relative_error:value")
    assert stored == pytest.approx(error["light"]["mean_relative_error"]["value"])
    image = previs.render(stages / "smoke.usda", "/Cameras/Front", WIDTH, measure_error=True, error_pixels=64)
    assert image.error.relative_rmse.value == pytest.approx(error["relative_rmse"]["value"], rel=1e-3)
    assert image.stats["measured_error"] == image.error.to_dict()


def test_without_being_asked_nothing_is_measured(run, stages, tmp_path):
    result = run("record", stages / "smoke.usda", tmp_path / "a.exr", "-w", WIDTH)
    assert (result.returncode, result.stdout) == (0, "")
    assert oiio.ImageBuf(str(tmp_path / "a.exr")).spec().getattribute("previs:error:pixels") is None
    assert previs.render(stages / "smoke.usda", "/Cameras/Front", 16).error is None


def test_it_can_be_asked_for_and_turned_off(run, stages, tmp_path):
    result = run("record", stages / "smoke.usda", tmp_path / "a.png", "-w", WIDTH, "--measure-error")
    assert result.returncode == 0 and "mean error" in result.stdout
    stats = tmp_path / "a.json"
    result = run(
        "record", stages / "smoke.usda", tmp_path / "a.png", "-w", WIDTH, "--stats", stats, "--no-measure-error"
    )
    assert result.returncode == 0 and result.stdout == ""
    assert "measured_error" not in json.loads(stats.read_text())["frames"][0]


def test_settings_for_a_limit_of_the_error(run, stages, tmp_path):
    """What was chosen is printed and stored; a knob that is given stays."""
    stats = tmp_path / "a.json"
    asked = ("-w", WIDTH, "--max-error", "0.03", "--coefficients", "8", "--set", "error_pixels=64", "--stats", stats)
    result = run("record", stages / "smoke.usda", tmp_path / "a.exr", *asked)
    assert (result.returncode, result.stderr) == (0, "")
    assert "mean error below 3 % with " in result.stdout
    [frame] = json.loads(stats.read_text())["frames"]
    assert frame["choice"]["met"] and "coefficients" not in frame["choice"]["knobs"]
    assert frame["settings"]["coefficients"] == 8
    assert frame["measured_error"]["mean_relative_error"]["high"] <= 0.03


def test_a_limit_that_cannot_be_met_is_a_warning(run, stages, tmp_path):
    fixed = ("--transmittance", "tfm-plain", "--steps", "4", "--map-size", "8", "--coefficients", "2")
    result = run("record", stages / "smoke.usda", tmp_path / "a.png", "-w", WIDTH, "--max-error", "1e-6", *fixed)
    assert result.returncode == 0 and (tmp_path / "a.png").exists()
    assert result.stderr.startswith("warning: no settings found for a mean error below 0.0001 %")


@pytest.mark.parametrize(
    ("asked", "said"),
    [
        (("--max-error", "0"), "above 0"),
        (("--max-error", "x"), "number"),
        (("--max-error", "1", "--reference"), "take one"),
    ],
)
def test_wrong_limits(run, stages, tmp_path, asked, said):
    result = run("record", stages / "smoke.usda", tmp_path / "a.png", *asked)
    assert result.returncode == 2 and said in result.stderr
