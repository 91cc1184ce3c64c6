"""`previs bench`: what it writes, and what it says when it cannot."""

import csv
import json
import os
import re

import pytest

pytest.importorskip("matplotlib")


@pytest.fixture(scope="module")
def bench(run, stages, tmp_path_factory):
    """A bench of a tiny stage: what was printed, and the folder."""
    folder = tmp_path_factory.mktemp("bench") / "made" / "here"
    result = run(
        *("bench", stages / "smoke.usda", "-o", folder, "-w", 32, "--repeats", 1),
        *("--methods", "quantile,tfm-plain,march", "--coefficients", "6,14", "--steps", "0,64"),
    )
    assert (result.returncode, result.stderr) == (0, "")
    return result, folder


def test_it_says_what_came_out(bench):
    result, folder = bench
    lines = result.stdout.splitlines()
    assert lines[0].startswith("With the default settings (default) a picture of the scene is off by ")
    assert lines[-1].endswith(f"open {folder / 'index.html'}")
    assert {f.name for f in folder.iterdir()} == {
        "index.html",
        "results.csv",
        "results.json",
        "tables.md",
        "pareto.png",
        "pareto.svg",
        "errors-smoke.png",
    }
    assert all(f.stat().st_size for f in folder.iterdir())


def test_the_results_are_there(bench):
    told = json.loads((bench[1] / "results.json").read_text())
    [scene] = told["scenes"]
    assert (scene["scene"], scene["size"], scene["default"]) == ("smoke", [32, 18], "default")
    reference = scene["reference"]
    assert reference["converged"] and reference["change_when_doubled"] < 5e-4
    rows = {row["variant"]: row for row in scene["results"]}
    assert list(rows) == [
        "converged march",
        *(f"{m} {n}{s}" for m in ("quantile", "tfm-plain") for n in (6, 14) for s in ("", ", 64 steps")),
        "march",
        "march, 64 steps",
        "default",
    ]
    assert rows["converged march"]["psnr"] == "inf" and rows["converged march"]["steps"] == reference["steps"]
    assert rows["quantile 14"]["mean_relative_error"] < rows["tfm-plain 6"]["mean_relative_error"] < 0.5
    assert rows["quantile 6, 64 steps"]["steps"] == rows["quantile 6, 64 steps"]["light_steps"] == 64
    assert [v for v, row in rows.items() if row["default"]] == ["default"]
    assert rows["default"]["relative_time"] == 1.0 and rows["converged march"]["speedup"] == 1.0
    assert any(row["front"] for row in rows.values()) and not rows["converged march"]["front"]
    for row in rows.values():
        assert row["seconds_low"] <= row["seconds"] <= row["seconds_high"]
    assert told["machine"]["device"] and told["options"]["steps"] == [0, 64]


def test_csv_and_json_agree(bench):
    told = json.loads((bench[1] / "results.json").read_text())
    with open(bench[1] / "results.csv", newline="") as file:
        cells = list(csv.DictReader(file))
    rows = [row for scene in told["scenes"] for row in scene["results"]]
    assert list(cells[0]) == list(told["columns"]) == list(rows[0])

    def text(value):
        return "" if value is None else str(value).lower() if isinstance(value, bool) else str(value)

    assert cells == [{name: text(value) for name, value in row.items()} for row in rows]


def test_the_page_holds_everything_itself(bench):
    text = (bench[1] / "index.html").read_text(encoding="utf-8")
    sources = re.findall(r"""(?:src|href|url)\s*[=(]\s*["']?([^"')\s>]+)""", text)
    assert len(sources) == 2 and all(s.startswith("data:image/jpeg;base64,") for s in sources)
    assert not re.search(r"<(?:link|script|iframe|object)|https?://|@import", text)
    for piece in ("<title>previs: speed against error</title>", "smoke", "tfm-plain 14", "How it was measured"):
        assert piece in text


def test_a_bare_vdb_and_a_default_that_is_not_among_the_variants(run, stages, tmp_path):
    result = run(
        *("bench", "ball.vdb", "--quick", "-w", 16, "--repeats", 1, "--methods", "tfm-plain"),
        *("--coefficients", "4", "-o", tmp_path / "b"),
        cwd=stages,
    )
    assert (result.returncode, result.stderr) == (0, "")
    [scene] = json.loads((tmp_path / "b" / "results.json").read_text())["scenes"]
    assert [row["variant"] for row in scene["results"]] == ["converged march", "tfm-plain 4", "default"]
    assert scene["default"] == "default"


@pytest.mark.parametrize(
    ("arguments", "status", "piece"),
    [
        (["none.usda"], 1, "none.usda: no such file"),
        (["smoke.usda", "none.usda"], 1, "none.usda: no such file"),
        (["empty.usda"], 1, "empty.usda: no volume, so there is nothing to measure"),
        (["text.usda"], 1, "text.usda"),
        (["smoke.usda", "-cam", "Side"], 1, "/Cameras/Front, /Cameras/Top"),
        (["smoke.usda", "-o", "text.usda"], 1, "text.usda: no folder can be made there"),
        (["smoke.usda", "--coefficients", "6,5"], 2, "coefficients: '5'"),
        (["smoke.usda", "--methods", "tfm,none"], 2, "'none'"),
        (["smoke.usda", "--steps", "many"], 2, "steps: 'many'"),
        (["smoke.usda", "--repeats", "0"], 2, "--repeats"),
        (["smoke.usda", "--vary", "map_filter"], 2, "--vary map_filter: write NAME=VALUE"),
        (["smoke.usda", "--vary", "map_filter=round"], 2, "map_filter: 'round'"),
        (["smoke.usda", "--vary", "filter=blend"], 2, "no knob 'filter'"),
        (["smoke.usda", "--vary", "steps=4"], 2, "steps has an option of its own"),
        (["--paper-only", "text.vdb"], 1, "text.vdb"),
    ],
)
def test_bad_input(run, stages, tmp_path, arguments, status, piece):
    (stages / "empty.usda").write_text('#usda 1.0\ndef Xform "World"\n{\n}\n')
    for name in ("text.usda", "text.vdb"):
        (stages / name).write_text("hello")
    output = [] if "-o" in arguments else ["-o", tmp_path / "b"]
    result = run("bench", *arguments, *output, cwd=stages)
    assert (result.returncode, result.stdout) == (status, "")
    [line] = result.stderr.splitlines()
    assert line.startswith("previs bench: ") and piece in line


def test_without_matplotlib_one_line_says_what_to_install(run, stages, tmp_path):
    (tmp_path / "matplotlib.py").write_text("raise ModuleNotFoundError('hidden', name='matplotlib')\n")
    path = os.pathsep.join(p for p in (str(tmp_path), os.environ.get("PYTHONPATH", "")) if p)
    result = run("bench", stages / "smoke.usda", "-o", tmp_path / "b", environment={"PYTHONPATH": path})
    assert (result.returncode, result.stdout) == (1, "")
    [line] = result.stderr.splitlines()
    assert line == "previs bench: drawing the plots needs matplotlib: pip install 'previs[bench]'"
    assert not (tmp_path / "b").exists()


@pytest.mark.parametrize(("verdicts", "status"), [(["pass", "reported"], 0), (["pass", "FAIL"], 1)])
def test_hard_cases_are_printed(monkeypatch, capsys, verdicts, status):
    from previs.bench import hard
    from previs.cli import main

    asked = {}

    def stand_in(renderer, methods=None, names=None, progress=None):
        asked["methods"] = methods
        progress(0.5, "a case")
        worst = hard.Measure(0.0, 1.0, "error", "%")
        return [hard.Outcome("a case", "tfm", 6, worst, verdict) for verdict in verdicts]

    monkeypatch.setattr(hard, "run", stand_in)
    assert main(["bench", "--hard", "--methods", "tfm,march"]) == status
    assert asked == {"methods": ["tfm", "march"]}
    lines = capsys.readouterr().out.splitlines()
    assert lines[1].split()[:5] == ["a", "case", "tfm", "6", "pass"] and len(lines) == 4
