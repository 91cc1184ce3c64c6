"""The pictures that previs made when somebody last looked at them, level by level.

A picture that is off is written to ``failed/`` beside its reference. When the change is meant, look at it there and run
``pytest tests/golden --regenerate``.
"""

from pathlib import Path

import numpy as np
import pytest
from comparison import difference, read_levels, write_failure, write_levels
from made_stages import MADE

import previs
from previs.io import display

HERE = Path(__file__).parent
SCENES = HERE.parents[1] / "scenes"
SIZE = (160, 90)

#: (name, scene, settings): the scenes as they come, and the other ways to their light.
PICTURES = [
    *((name, name, {}) for name in ("plume", "pyroclastic", "sandstorm", "cloud", "shaft", "duo", *MADE)),
    ("duo_14", "duo", {"transmittance": "quantile", "coefficients": 14}),
    ("duo_tfm", "duo", {"transmittance": "tfm"}),
    ("plume_plain", "plume", {"transmittance": "tfm-plain", "coefficients": 14}),
    ("instances_march", "instances", {"transmittance": "march", "steps": 64, "light_steps": 64}),
    ("shapes_antialias", "shapes", {"antialias": 2, "ambient": 0.1}),
]


@pytest.mark.gl
@pytest.mark.golden
@pytest.mark.parametrize(("name", "scene", "settings"), PICTURES, ids=[p[0] for p in PICTURES])
def test_picture(software, regenerate, tmp_path, name, scene, settings):
    stage = MADE[scene](tmp_path) if scene in MADE else SCENES / f"{scene}.usda"
    image = previs.render(stage, size=SIZE, **settings)
    levels = (display(image.color) * 255.0 + 0.5).astype(np.uint8)
    reference = HERE / "images" / f"{name}.png"
    if regenerate:
        if not reference.is_file() or not np.array_equal(read_levels(reference), levels):
            write_levels(reference, levels)
        return
    assert reference.is_file(), f"no {reference.name} yet: pytest tests/golden --regenerate writes it"
    expected = read_levels(reference)
    wrong = difference(levels, expected)
    if wrong:
        write_failure(HERE / "failed", name, levels, expected)
    assert not wrong, f"{name} {wrong}; see tests/golden/failed/{name}_error.png"


def test_every_golden_picture_is_compared():
    assert {p.stem for p in (HERE / "images").glob("*")} == {p[0] for p in PICTURES}


def test_the_tolerance_is_one_level():
    reference = np.full((90, 160, 3), 100, np.uint8)
    assert difference(reference + np.uint8(1), reference) == ""
    assert "off by more than 1 level, the worst by 2" in difference(reference + np.uint8(2), reference)


def test_a_few_values_may_be_off_by_three():
    reference = np.full((90, 160, 3), 100, np.uint8)
    image = reference.copy()
    image[0, :14] += 3
    assert difference(image, reference) == ""
    image[0, :15] = 103
    assert "0.10 %" in difference(image, reference)
    image[0] = 100
    image[0, 0, 0] = 96
    assert "the worst by 4" in difference(image, reference)


def test_another_size_is_another_picture():
    assert "is 3×2 pixels" in difference(np.zeros((2, 3, 3), np.uint8), np.zeros((3, 2, 3), np.uint8))


def test_a_failure_leaves_three_pictures(tmp_path):
    image, reference = np.full((4, 5, 3), 7, np.uint8), np.full((4, 5, 3), 5, np.uint8)
    write_failure(tmp_path / "failed", "x", image, reference)
    for part, level in (("image", 7), ("reference", 5), ("error", 64)):
        np.testing.assert_array_equal(read_levels(tmp_path / "failed" / f"x_{part}.png"), level)
