"""Knobs that a stage authors: below the flags, above the defaults, the same in every way in."""

import json

import numpy as np
import pytest
from small_stages import usda

import previs
from previs.io import load_color
from previs.quality import preset
from previs.settings import TABLE, Settings


@pytest.fixture
def look(stages, tmp_path):
    """A layer of overrides, and a root that has it over the stage."""
    with previs.open(stages / "smoke.usda") as scene:
        scene.set_setting("map_size", 48)
        scene.set_setting("coefficients", 12)
        scene.set_medium("/Smoke", extinction=9)
        scene.save_overrides(tmp_path / "look.usda")
    root = tmp_path / "both.usda"
    root.write_text(f"#usda 1.0\n(\n subLayers = [@./look.usda@, @{stages / 'smoke.usda'}@]\n)\n")
    return root


def longest_sides(plan):
    """Of the maps, which are no wider or higher than what they hold."""
    return {max(p["resolution"][:2]) for p in plan if p["pass"].startswith("transmittance_map")}


def test_overrides_over_the_shot_give_the_same_picture(run, stages, look, tmp_path):
    done = run("record", look, tmp_path / "a.exr", "-w", 64)
    assert done.returncode == 0, done.stderr
    with previs.open(stages / "smoke.usda", tmp_path / "look.usda") as scene:
        edited = previs.render(scene, size=64)
        plain = previs.render(stages / "smoke.usda", size=64)
    recorded = load_color(tmp_path / "a.exr")[0]
    assert np.array_equal(recorded, edited.color)
    assert not np.array_equal(recorded, plain.color)


def test_info_follows_the_stage_and_the_flags(run, look):
    plan = json.loads(run("info", look, "--json").stdout)["plan"]
    assert longest_sides(plan) == {48}
    plan = json.loads(run("info", look, "--json", "--map-size", 32).stdout)["plan"]
    assert longest_sides(plan) == {32}


def test_a_flag_that_says_the_default_wins(run, look, tmp_path):
    for name, flags in (("a", ()), ("b", ("--coefficients", 6)), ("c", ("--set", "coefficients=12"))):
        done = run("record", look, tmp_path / f"{name}.exr", "-w", 64, *flags)
        assert done.returncode == 0, done.stderr
    a, b, c = (load_color(tmp_path / f"{name}.exr")[0] for name in "abc")
    assert np.array_equal(a, c)
    assert not np.array_equal(a, b)
    with previs.open(look) as scene:
        asked = previs.render(scene, size=64, transmittance="quantile", coefficients=6)
        assert np.array_equal(asked.color, b)


def test_a_number_of_coefficients_asks_for_maps_that_have_them(run, stages, tmp_path):
    """By the flag; where a method without is asked for as well, it is said once."""
    smoke = stages / "smoke.usda"
    cases = {
        ("--coefficients", 14): ("quantile", 14, False),
        ("--coefficients", 14, "--transmittance", "tfm"): ("tfm", 14, False),
        ("--coefficients", 14, "--set", "transmittance=march"): ("march", 14, True),
        ("--set", "coefficients=14"): ("slices", 14, True),
        (): ("slices", 6, False),
    }
    for flags, (method, count, idle) in cases.items():
        found = json.loads(run("info", smoke, "--json", *flags).stdout)
        assert (found["settings"]["transmittance"], found["settings"]["coefficients"]) == (method, count)
        assert [n["message"] for n in found["notes"] if n["path"] == "coefficients"] == (
            [f"transmittance={method} stores none"] if idle else []
        )
    done = run("record", smoke, tmp_path / "a.###.exr", "-f", "1:2", "-w", 16, "--set", "coefficients=14")
    assert done.returncode == 0
    assert done.stderr.count("warning: coefficients: ignored: transmittance=slices stores none") == 1


def test_a_knob_that_cannot_be_used_is_a_warning(run, tmp_path):
    text = """
def Sphere "Ball" {}
def Scope "Render" { def RenderSettings "main" { int previs:coefficients = 7
    int previs:map_size = 32 }
 def RenderSettings "other" { int previs:steps = -3 }
}
"""
    (tmp_path / "a.usda").write_text(usda(text))
    done = run("record", tmp_path / "a.usda", tmp_path / "a.png", "-w", 16, "-rs", "/Render/main")
    assert done.returncode == 0
    assert "warning: /Render/main: ignored: previs:coefficients: 7 is not an even number" in done.stderr
    assert "/Render/other" not in done.stderr
    done = run("info", tmp_path / "a.usda", "-rs", "/Render/other")
    assert "/Render/other: ignored: previs:steps: -3 is not" in done.stdout
    done = run("record", tmp_path / "a.usda", tmp_path / "a.png", "-rs", "/Ball")
    assert (done.returncode, done.stderr.count("\n")) == (1, 1)
    assert "/Ball: not a RenderSettings prim" in done.stderr


def test_a_preset_is_above_the_stage_and_below_the_flags(run, look, tmp_path):
    flags = {
        "a": (),
        "b": ("--quality", "draft"),
        "c": ("--quality", "draft", "--set", "coefficients=8", "--steps", 40),
    }
    found = {name: json.loads(run("info", look, "--json", *f).stdout)["settings"] for name, f in flags.items()}
    draft = preset("draft")
    assert (found["a"]["coefficients"], found["a"]["map_size"]) == (12, 48)
    assert {name: found["b"][name] for name in draft} == draft
    assert {name: found["c"][name] for name in draft} == {**draft, "coefficients": 8, "steps": 40}
    final = json.loads(run("info", look, "--json", "--quality", "final").stdout)["settings"]
    assert final == dict(Settings())
    done = run("record", look, tmp_path / "a.exr", "-w", 64, *flags["c"])
    assert done.returncode == 0, done.stderr
    with previs.open(look) as scene:
        image = previs.render(scene, size=64, quality="draft", coefficients=8, steps=40)
    assert np.array_equal(load_color(tmp_path / "a.exr")[0], image.color)


def test_info_prints_the_settings_in_force(run, look):
    lines = run("info", look, "--quality", "preview", "--set", "ambient=0.5").stdout
    rows = [line.strip() for line in lines.splitlines()]
    assert f"settings ({len(TABLE)})" in rows
    assert "march_divisor 2 (default 1)" in rows and "ambient 0.5 (default 0.0)" in rows
    assert "coefficients 6" in rows


def test_presets_that_are_none_or_do_not_fit(run, look, tmp_path):
    done = run("record", look, tmp_path / "a.exr", "--quality", "best")
    assert done.returncode == 2 and "draft" in done.stderr
    done = run("record", look, tmp_path / "a.exr", "--quality", "draft", "--reference")
    assert done.returncode == 2 and "take one" in done.stderr and done.stderr.count("\n") == 1
    assert not (tmp_path / "a.exr").exists()
    with pytest.raises(ValueError, match="'best' is not one of"):
        previs.render(look, size=16, quality="best")
