"""`previs bench --speed`: what it writes, in figures that physics allows; nothing here asserts a time."""

import csv
import importlib.util
import json
import math
import re

import pytest

pytest.importorskip("matplotlib")


@pytest.fixture(scope="module")
def bench(run, stages, tmp_path_factory):
    """A bench of a tiny stage: what was printed, and the folder."""
    folder = tmp_path_factory.mktemp("speed") / "made" / "here"
    result = run(
        *("bench", "--speed", stages / "smoke.usda", "-o", folder, "-w", 32, "--repeats", 1),
        *("--scaling", "coefficients"),
    )
    assert (result.returncode, result.stderr) == (0, "")
    return result, folder


@pytest.fixture(scope="module")
def told(bench):
    return json.loads((bench[1] / "speed.json").read_text())


def test_the_files_are_there(bench):
    result, folder = bench
    names = {"index.html", "speed.csv", "speed.json", "speed.md", "speed.png", "speed.svg"}
    names |= {"scaling-coefficients.png", "scaling-coefficients.svg"}
    assert {f.name for f in folder.iterdir()} == names and all(f.stat().st_size for f in folder.iterdir())
    lines = result.stdout.splitlines()
    assert lines[-1] == f"{len(names)} files in {folder}; open {folder / 'index.html'}"
    assert lines[-2].startswith("By default a whole frame of the scene takes ")
    assert "**smoke, 32×18**" in lines


def test_the_figures_are_finite_and_in_order(told):
    [scene] = told["scenes"]
    rows = {row["way"]: row for row in scene["results"]}
    *others, floor = rows.values()
    equal = scene["equal_error"]
    brute = rows[f"brute force, {equal['steps']} steps"]
    assert rows["default"]["settings"] == "" and floor["way"] == "floor" and "all off, light marched" in rows
    for row in others:
        for name in ("whole_process", "whole_wall", "whole_over_floor"):
            low, middle, high = (row[name + end] for end in ("_low", "", "_high"))
            assert 0.0 < low <= middle <= high < math.inf
        low, error, high = (row["mean_relative_error" + end] for end in ("_low", "", "_high"))
        assert 0.0 <= low <= error <= high < 0.5
        assert row["camera_process"] > 0.0 and row["light_process"] > 0.0 and not row["estimated"]
    assert floor["whole_process"] > 0.0
    assert floor["mean_relative_error"] is None and floor["whole_over_floor"] is None and floor["speedup"] is None
    # Light that is marched from voxel to voxel is nearer the truth than what maps keep of it.
    assert rows["all off, light marched"]["mean_relative_error"] < rows["default"]["mean_relative_error"]
    assert equal["tried"][-1][0] == equal["steps"] and brute["speedup"] == 1.0
    assert equal["reached"] == (equal["tried"][-1][1] <= rows["default"]["mean_relative_error"])
    assert all(error > rows["default"]["mean_relative_error"] for _, error in equal["tried"][:-1])
    assert equal["tried"][-1][1] == pytest.approx(brute["mean_relative_error"], rel=1e-3)
    assert scene["passes"]["default"]["march"] > 0.0 and "transmittance_map" in scene["passes"]["default"]


def test_the_exponents_are_finite(told):
    [sweep] = told["scaling"]
    assert (sweep["name"], sweep["left_out"]) == ("coefficients", [])
    for series in sweep["series"]:
        assert series["amounts"] == [2.0, 6.0, 10.0, 14.0] and all(0.0 < s < math.inf for s in series["seconds"])
        assert math.isfinite(series["fit"]["exponent"]) and series["fit"]["standard_error"] >= 0.0


def test_csv_and_json_agree(bench, told):
    with open(bench[1] / "speed.csv", newline="") as file:
        cells = list(csv.DictReader(file))
    rows = told["scenes"][0]["results"]
    assert list(cells[0]) == list(told["columns"]) == list(rows[0])
    assert [c["way"] for c in cells] == [r["way"] for r in rows]
    assert [c["whole_process"] for c in cells] == [str(r["whole_process"]) for r in rows]


def test_the_page_holds_everything_itself(bench):
    text = (bench[1] / "index.html").read_text(encoding="utf-8")
    sources = re.findall(r"""(?:src|href|url)\s*[=(]\s*["']?([^"')\s>]+)""", text)
    assert len(sources) == 2 and all(s.startswith("data:image/jpeg;base64,") for s in sources)
    for piece in ("<title>previs: what a frame costs</title>", "smoke", "How the cost grows", "How it was measured"):
        assert piece in text


def test_vtk_is_compared_where_it_is(told):
    peers = told["peers"]
    if importlib.util.find_spec("vtk") is None:
        assert peers == []
        return
    previs, vtk = peers
    assert previs["name"] == "previs" and vtk["name"].startswith("VTK") and not vtk["failure"]
    assert 0.0 <= previs["mean_relative_error"] < vtk["mean_relative_error"] < 0.6


@pytest.mark.parametrize(
    ("arguments", "status", "piece"),
    [
        (["--speed", "none.usda"], 1, "none.usda: no such file"),
        (["--speed", "void.usda"], 1, "void.usda: no volume, so there is nothing to measure"),
        (["--speed", "smoke.usda", "-cam", "Side"], 1, "/Cameras/Front, /Cameras/Top"),
        (["--speed", "smoke.usda", "--scaling", "voxels,colours"], 2, "'colours' is none of voxels"),
        (["smoke.usda", "--full"], 2, "--full and --scaling go with --speed"),
        (["smoke.usda", "--scaling", "none"], 2, "--full and --scaling go with --speed"),
    ],
)
def test_bad_input(run, stages, tmp_path, arguments, status, piece):
    (stages / "void.usda").write_text('#usda 1.0\ndef Xform "World"\n{\n}\n')
    result = run("bench", *arguments, "-o", tmp_path / "b", cwd=stages)
    assert (result.returncode, result.stdout) == (status, "")
    [line] = result.stderr.splitlines()
    assert line.startswith("previs bench: ") and piece in line
