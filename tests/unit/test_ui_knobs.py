"""The tables of knobs, what they format and parse, and the lobes of the polar plot. No window."""

import inspect
import itertools
import math
from dataclasses import fields

import numpy as np
import pytest

from previs.description import PHASES, Medium
from previs.scene import LightValues, Scene
from previs.settings import TABLE
from previs.ui import files, knobs
from previs.ui.knobs import LIGHT, LIGHT_BY_NAME, MEDIUM, MEDIUM_BY_NAME, RENDER, RENDER_BY_NAME, VIEW, Knob
from previs.ui.lobe import ISOTROPIC, Polar, lobe, outline

ALL = (*MEDIUM, *LIGHT, *RENDER, *VIEW)
BOUNDED = [k for k in (*MEDIUM, *LIGHT) if k.kind in ("float", "color")]


@pytest.fixture
def scene():
    with Scene() as opened:
        opened.add_sphere_medium("/smoke")
        opened.add_spot_light("/spot", (0.0, 2.0, 0.0), (0.0, 0.0, 0.0))
        yield opened


# --- the tables -------------------------------------------------------------------------------------------------------


def test_every_value_of_a_medium_has_a_knob():
    assert set(MEDIUM_BY_NAME) == {f.name for f in fields(Medium)} | {"scattering", "absorption"}


def test_every_value_of_a_light_has_a_knob_but_those_that_an_artist_does_not_set():
    hidden = {"kind", "focus_tint", "treat_as_point"}
    # Where a light is has knobs of its own: angles and coordinates.
    hidden |= {"position", "direction"}
    assert set(LIGHT_BY_NAME) == {f.name for f in fields(LightValues)} - hidden


def test_every_setting_has_a_knob_that_says_what_the_table_says():
    assert [k.name for k in RENDER] == [s.name for s in TABLE]
    for knob, setting in zip(RENDER, TABLE, strict=True):
        assert (knob.doc, knob.default, knob.choices) == (setting.doc, setting.default, setting.choices)
        assert (knob.minimum, knob.maximum, knob.automatic) == (setting.minimum, setting.maximum, setting.automatic)
        assert knob.label != setting.name.replace("_", " ") or " " not in knob.label


def test_names_are_unique_since_they_are_identifiers_of_widgets():
    names = [k.name for k in ALL]
    assert len(names) == len(set(names))


@pytest.mark.parametrize("knob", ALL, ids=lambda k: k.name)
def test_a_knob_explains_itself(knob: Knob):
    text = knob.tooltip()
    assert knob.doc in text and "Range: " in text and f"Default: {knob.format(knob.default)}" in text
    assert len(knob.label) <= 19, "wider than the column of labels"
    assert len(knob.choice_labels) in (0, len(knob.choices))


@pytest.mark.parametrize("knob", BOUNDED, ids=lambda k: k.name)
def test_the_comfortable_range_is_legal(knob: Knob):
    assert knob.low < knob.high
    assert knob._clamped(knob.low) == knob.low and knob._clamped(knob.high) == knob.high


def _author(scene, knob, value):
    if knob.name in MEDIUM_BY_NAME:
        scene.set_medium("/smoke", **{knob.name: value})
        return getattr(scene.medium("/smoke"), knob.name)
    scene.set_light("/spot", **{knob.name: value})
    return getattr(scene.light_values("/spot"), knob.name)


ENDS = ("low", "high", "minimum", "maximum")
#: A sphere light has none of these.
SIZES_OF_OTHERS = ("width", "height", "length", "angle")


@pytest.mark.parametrize(
    ("knob", "end"),
    [
        pytest.param(k, end, id=f"{k.name}-{end}")
        for k in BOUNDED
        for end in ENDS
        if getattr(k, end) is not None and k.name not in SIZES_OF_OTHERS
    ],
)
def test_the_stage_takes_what_a_knob_calls_legal(knob: Knob, end: str, scene):
    value = getattr(knob, end)
    shown = _author(scene, knob, (value,) * 3 if knob.kind == "color" else value)
    # g is kept off the Dirac delta at its ends.
    assert np.allclose(shown, value, rtol=1e-5, atol=2e-3)


#: UsdLux takes negative colours and any temperature; the panel does not.
STRICTER = ("color", "color_temperature")


@pytest.mark.parametrize(
    "knob", [k for k in BOUNDED if k.minimum is not None and k.name not in STRICTER], ids=lambda k: k.name
)
def test_the_stage_refuses_what_a_knob_calls_illegal(knob: Knob, scene):
    below = knob.minimum - 0.5
    with pytest.raises(ValueError, match=knob.name):
        _author(scene, knob, (below,) * 3 if knob.kind == "color" else below)


def test_the_panel_offers_every_phase_function():
    assert MEDIUM_BY_NAME["phase"].choices == PHASES


def test_methods_take_the_names_of_the_tables():
    for method in (Scene.set_medium, Scene.set_light):
        assert "values" in inspect.signature(method).parameters
        documented = method.__doc__
        table = MEDIUM if method is Scene.set_medium else LIGHT
        assert all(k.name in documented for k in table)


# --- values -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("knob", [k for k in ALL if k.kind in ("float", "int", "color")], ids=lambda k: k.name)
def test_fraction_and_value_are_each_others_inverse(knob: Knob):
    for part in (0.0, 0.1, 0.37, 0.5, 0.99, 1.0):
        assert knob.fraction(knob.at(part)) == pytest.approx(part, abs=1e-9)
    assert knob.at(0.0) == pytest.approx(knob.low) and knob.at(1.0) == pytest.approx(knob.high)
    values = [knob.at(p) for p in np.linspace(0.0, 1.0, 50)]
    assert all(a < b for a, b in itertools.pairwise(values))


def test_a_logarithmic_slider_gives_equal_ratios_equal_room():
    knob = MEDIUM_BY_NAME["density_scale"]
    assert knob.at(0.5) == pytest.approx(math.sqrt(knob.low * knob.high))


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("3", 3.0),
        ("2,5", 2.5),
        (" 1e3 ", 1000.0),
        ("-4", 0.0),
        ("250 ×", 250.0),
        ("much", None),
        ("", None),
        ("nan", None),
    ],
)
def test_typed_numbers(text, value):
    assert MEDIUM_BY_NAME["density_scale"].parse(text) == value


@pytest.mark.parametrize(
    ("text", "value"),
    [("0.5", (0.5,) * 3), ("0.1, 0.2 0.3", (0.1, 0.2, 0.3)), ("2", (1.0,) * 3), ("1 2", None), ("red", None)],
)
def test_typed_colors(text, value):
    assert MEDIUM_BY_NAME["albedo"].parse(text) == value


def test_a_bright_color_is_taken_as_it_is():
    assert MEDIUM_BY_NAME["extinction"].parse("12, 8, 4") == (12.0, 8.0, 4.0)


def test_automatic_and_stepped_whole_numbers():
    size, coefficients = RENDER_BY_NAME["map_size"], RENDER_BY_NAME["coefficients"]
    assert size.parse("auto") == 0 and size.parse("3") == 8 and size.format(0) == "auto"
    assert coefficients.parse("7") in (6, 8) and coefficients.parse("99") == 16 and coefficients.parse("1") == 2
    for knob in RENDER:
        setting = next(s for s in TABLE if s.name == knob.name)
        if knob.kind in ("int", "float"):
            for typed in ("-5", "0", "1", "3.3", "17", "1e9"):
                setting.parse(knob.parse(typed))


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (0.0, "0"),
        (1.0, "1"),
        (0.84, "0.84"),
        (12.3456, "12.35"),
        (1500.0, "1500"),
        (0.00012, "0.00012"),
        (2.5e7, "2.5e+07"),
    ],
)
def test_numbers_are_short(value, text):
    assert knobs.number(value) == text


def test_values_are_read_with_their_unit():
    assert MEDIUM_BY_NAME["extinction"].format((12.0, 12.0, 12.0)) == "12 / unit"
    assert MEDIUM_BY_NAME["albedo"].format((0.84, 0.83, 0.82)) == "0.84, 0.83, 0.82"
    assert LIGHT_BY_NAME["cone_angle"].format(30.0) == "30°"
    assert LIGHT_BY_NAME["visible"].format(False) == "off"
    assert MEDIUM_BY_NAME["phase"].format("two_lobe") == "Two lobes"


# --- colours ----------------------------------------------------------------------------------------------------------


def test_chroma_and_magnitude_make_the_color():
    color = (12.0, 6.0, 3.0)
    assert knobs.magnitude(color) == 12.0 and knobs.chroma(color) == (1.0, 0.5, 0.25)
    assert knobs.scaled(color, 2.0) == (2.0, 1.0, 0.5)
    assert knobs.scaled((0.0, 0.0, 0.0), 2.0, fallback=(1.0, 0.5, 0.0)) == (2.0, 1.0, 0.0)


def test_a_color_is_the_same_after_a_way_through_the_picker():
    for level in (0.0, 0.001, 0.0031308, 0.18, 0.5, 1.0):
        assert knobs.decoded(knobs.encoded((level,) * 3)) == pytest.approx((level,) * 3, abs=1e-7)


# --- the lobe ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("phase", "g", "g2", "mix"),
    [
        ("isotropic", 0.0, 0.0, 0.0),
        ("rayleigh", 0.0, 0.0, 0.0),
        ("schlick", 0.6, 0.0, 0.0),
        ("hg", 0.2, 0.0, 0.0),
        ("hg", -0.7, 0.0, 0.0),
        ("hg", 0.95, 0.0, 0.0),
        ("two_lobe", 0.9, -0.5, 0.3),
    ],
)
def test_the_points_of_a_lobe_integrate_to_one(phase, g, g2, mix):
    assert lobe(phase, g, g2, mix).integral() == pytest.approx(1.0, abs=4e-3)


@pytest.mark.parametrize("radius", ["linear", "log"])
@pytest.mark.parametrize("g", [-0.999, -0.3, 0.0, 0.2, 0.9, 1.0])
def test_the_outline_is_a_closed_line_inside_the_circle(radius, g):
    sampled = lobe("hg", g)
    line = outline(sampled, Polar.fitting([sampled], radius))
    assert np.all(np.isfinite(line)) and np.all(np.hypot(*line.T) <= 1.0 + 1e-9)
    assert line[0] == pytest.approx(line[-1], abs=1e-12)
    assert np.hypot(*line.T).max() == pytest.approx(1.0, abs=1e-9)
    # Forward is to the right.
    assert g == 0.0 or np.sign(line[np.hypot(*line.T).argmax(), 0]) == np.sign(g)


def test_a_lobe_weaker_than_even_scattering_stays_inside_its_circle():
    polar = Polar.fitting([lobe("hg", 0.2)], "log")
    assert 0.0 < polar.radii(ISOTROPIC) < 1.0


# --- files ------------------------------------------------------------------------------------------------------------


def test_a_listing_has_folders_and_fitting_files_in_reading_order(tmp_path):
    for name in ("frame10.vdb", "frame9.VDB", "note.txt", ".hidden.vdb"):
        (tmp_path / name).touch()
    for name in ("b", "A", ".git"):
        (tmp_path / name).mkdir()
    found = files.listing(str(tmp_path), (".vdb",))
    assert found.folders == ("A", "b") and found.files == ("frame9.VDB", "frame10.vdb") and not found.error
    assert files.listing(str(tmp_path)).files == ("frame9.VDB", "frame10.vdb", "note.txt")
    assert files.listing(str(tmp_path / "missing")).error


def test_names_that_mix_words_and_numbers_can_be_sorted():
    assert sorted(["a1", "1a", "a", "10", "2"], key=files.reading_order) == ["1a", "2", "10", "a", "a1"]


def test_paths_as_typed(tmp_path, monkeypatch):
    monkeypatch.setenv("SHOT", "s1")
    folder = str(tmp_path)
    assert files.typed_path("$SHOT/x.usda", folder) == str(tmp_path / "s1" / "x.usda")
    assert files.typed_path("../y.usda", folder) == str(tmp_path.parent / "y.usda")
    assert files.typed_path("~", folder) == files.typed_path(str(files.Path.home()), folder)
    assert files.with_ending("/a/look", (".usda", ".usd")) == "/a/look.usda"
    assert files.with_ending("/a/look.USD", (".usda", ".usd")) == "/a/look.USD"
    assert files.nearest_folder(str(tmp_path / "no" / "such")) == str(tmp_path)
