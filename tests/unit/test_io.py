"""Pictures to files and back."""

import os
import stat
from pathlib import Path

import numpy as np
import OpenImageIO as oiio
import pytest

from previs import Image, PrevisError
from previs.io import (
    DisplayLut,
    auto_exposure,
    bake_lut,
    check_format,
    color_views,
    display,
    load_color,
    parse_exposure,
    save_image,
    written_beside,
)

CONTRACTED = ["R", "G", "B", "A", "Z"]


def image(height: int = 6, width: int = 9, aovs: tuple[str, ...] = ("albedo", "normal"), **stats) -> Image:
    random = np.random.default_rng(1)
    plane = lambda *shape: random.normal(1.0, 2.0, (height, width, *shape)).astype(np.float32)  # noqa: E731
    depth = plane()
    depth[0, :3] = np.inf
    return Image(plane(3), plane(), depth, {name: plane(3) for name in aovs}, stats)


def channels(path: Path) -> dict[str, np.ndarray]:
    buffer = oiio.ImageBuf(str(path))
    pixels = buffer.get_pixels(oiio.FLOAT)
    return {name: pixels[..., i] for i, name in enumerate(buffer.spec().channelnames)}


# --- the display transform ----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("linear", "shown"), [(0.0, 0.0), (0.0031308, 0.04045), (0.18, 0.46136), (0.5, 0.73536), (1.0, 1.0), (7.0, 1.0)]
)
def test_srgb_curve(linear, shown):
    np.testing.assert_allclose(display(np.full((1, 1, 3), linear)), shown, atol=2e-5)


def test_exposure_is_in_stops():
    colour = np.full((2, 2, 3), 0.2, np.float32)
    np.testing.assert_allclose(display(colour, 1.0), display(2.0 * colour), atol=1e-6)
    np.testing.assert_allclose(display(colour, -2.0, "disabled"), 0.05, atol=1e-6)


def test_broken_values_are_shown_as_black_or_white():
    colour = np.array([[[np.nan, -1.0, -np.inf], [np.inf, 1e30, 0.5]]], np.float32)
    for correction in ("disabled", "sRGB"):
        shown = display(colour, 0.0, correction)
        np.testing.assert_array_equal(shown[0, 0], 0.0)
        np.testing.assert_array_equal(shown[0, 1, :2], 1.0)


def test_open_color_io_takes_the_built_in_config(monkeypatch):
    monkeypatch.delenv("OCIO", raising=False)
    ramp = np.repeat(np.linspace(0.0, 4.0, 32, dtype=np.float32), 3).reshape(1, 32, 3)
    shown = display(ramp, 0.0, "openColorIO")
    assert shown.shape == ramp.shape
    assert (np.diff(shown[0, :, 1]) > 0.0).all(), "a tone scale that keeps the order and does not clip at 1"
    assert not np.allclose(shown, display(ramp), atol=0.05)


def test_a_missing_open_color_io_config_is_named(monkeypatch, tmp_path):
    monkeypatch.setenv("OCIO", str(tmp_path / "none.ocio"))
    with pytest.raises(PrevisError, match=r"none\.ocio") as error:
        display(np.zeros((2, 2, 3)), 0.0, "openColorIO")
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("bad", ["srgb", "", None])
def test_unknown_colour_correction(bad):
    with pytest.raises(ValueError, match="disabled, sRGB, openColorIO"):
        display(np.zeros((1, 1, 3)), 0.0, bad)


@pytest.mark.parametrize("bad", ["bright", "", None, "nan", float("inf"), 65, "-1e9"])
def test_exposures_that_are_none(bad):
    with pytest.raises(ValueError, match="stops from -64 to 64, or auto"):
        parse_exposure(bad)


def test_exposures():
    assert [parse_exposure(x) for x in ("auto", "-1.5", 2, 64)] == ["auto", -1.5, 2.0, 64.0]


def test_automatic_exposure_puts_the_brightest_percent_at_its_level():
    colour = np.zeros((100, 100, 3), np.float32)
    colour[:50] = np.linspace(0.0, 1000.0, 5000, dtype=np.float32).reshape(50, 100, 1)
    colour[0, 0] = 1e9  # one glint counts as little as it should
    stops = auto_exposure(colour)
    lit = colour.max(axis=-1)
    assert np.percentile(lit[lit > 0.0], 99.0) * 2.0**stops == pytest.approx(0.8, rel=1e-4)
    np.testing.assert_allclose(display(colour, "auto"), display(colour, stops))


@pytest.mark.parametrize("value", [0.0, -1.0, np.nan])
def test_automatic_exposure_of_a_dark_or_broken_picture_is_none(value):
    assert auto_exposure(np.full((4, 4, 3), value)) == 0.0


def test_automatic_exposure_does_not_show_rounding_errors():
    assert display(np.full((4, 4, 3), 1e-15), "auto").max() < 1 / 255


# --- files --------------------------------------------------------------------------------------------------------


def test_exr_keeps_every_plane_to_the_bit(tmp_path):
    made = image(aovs=("albedo", "normal", "transmittance", "volume", "emission"))
    made.save(tmp_path / "a.exr")
    stored = channels(tmp_path / "a.exr")
    names = [*CONTRACTED, *(f"albedo.{c}" for c in "RGB"), *(f"normal.{c}" for c in "XYZ")]
    names += [f"{plane}.{c}" for plane in ("transmittance", "volume", "emission") for c in "RGB"]
    # EXR keeps channels sorted by their layers' names; readers find them by name.
    assert sorted(stored) == sorted(names)
    assert list(stored)[:5] == CONTRACTED
    for i, c in enumerate("RGB"):
        np.testing.assert_array_equal(stored[c], made.color[..., i])
    np.testing.assert_array_equal(stored["A"], made.alpha)
    np.testing.assert_array_equal(stored["Z"], made.depth)
    for name, plane in made.aovs.items():
        for i, c in enumerate("XYZ" if name == "normal" else "RGB"):
            np.testing.assert_array_equal(stored[f"{name}.{c}"], plane[..., i])


def test_exr_has_only_the_planes_there_are(tmp_path):
    image(aovs=()).save(tmp_path / "a.exr")
    assert list(channels(tmp_path / "a.exr")) == CONTRACTED


def test_exr_says_how_it_was_made(tmp_path):
    image(settings={"coefficients": 14, "transmittance": "tfm", "projective_steps": True}).save(tmp_path / "a.exr")
    spec = oiio.ImageBuf(str(tmp_path / "a.exr")).spec()
    assert spec.get_int_attribute("previs:coefficients") == 14
    assert spec.get_string_attribute("previs:transmittance") == "tfm"
    assert spec.get_int_attribute("previs:projective_steps") == 1


def test_exr_is_scene_referred_whatever_the_exposure(tmp_path):
    made = image()
    made.save(tmp_path / "a.exr", exposure=3.0, color_correction="openColorIO")
    colour, linear = load_color(tmp_path / "a.exr")
    assert linear
    np.testing.assert_array_equal(colour, made.color)


def test_png_holds_the_display_transform_rounded_to_8_bits(tmp_path):
    made = image()
    made.save(tmp_path / "a.png", exposure=-1.0)
    stored, linear = load_color(tmp_path / "a.png")
    assert not linear
    np.testing.assert_allclose(stored, display(made.color, -1.0), atol=0.5 / 255 + 1e-6)
    assert list(channels(tmp_path / "a.png")) == ["R", "G", "B"]


def test_jpg(tmp_path):
    flat = Image(np.full((16, 16, 3), 0.5, np.float32), np.ones((16, 16)), np.ones((16, 16)))
    for name in ("a.jpg", "a.JPEG"):
        flat.save(tmp_path / name)
        stored, linear = load_color(tmp_path / name)
        assert not linear
        np.testing.assert_allclose(stored, display(flat.color), atol=0.02)


@pytest.mark.parametrize("name", ["a", "a.tif", "a.png.bak", ".exr"])
def test_unknown_endings_are_refused_before_anything_is_written(name, tmp_path):
    with pytest.raises(PrevisError, match=r"use one of \.exr, \.png, \.jpg") as error:
        image().save(tmp_path / name)
    assert str(tmp_path / name) in str(error.value)
    assert not list(tmp_path.iterdir())


def test_endings_in_capitals():
    assert check_format("A.EXR") == ".exr"


@pytest.mark.parametrize("ending", ["exr", "png", "jpg"])
def test_a_folder_that_is_not_there(ending, tmp_path):
    with pytest.raises(PrevisError, match="cannot be written: No such file or directory"):
        image().save(tmp_path / "none" / f"a.{ending}")


@pytest.mark.skipif(os.name != "posix" or os.geteuid() == 0, reason="root writes anywhere")
def test_a_folder_without_permission(tmp_path):
    tmp_path.chmod(0o500)
    with pytest.raises(PrevisError, match="cannot be written: Permission denied"):
        image().save(tmp_path / "a.png")


def test_a_folder_in_the_place_of_the_file(tmp_path):
    (tmp_path / "a.png").mkdir()
    with pytest.raises(PrevisError, match=r"a\.png: cannot be written"):
        image().save(tmp_path / "a.png")
    assert [p.name for p in tmp_path.iterdir()] == ["a.png"]


def test_an_existing_file_survives_a_failure(tmp_path):
    path = tmp_path / "a.png"
    path.write_bytes(b"good")

    class Stopped(Exception):
        pass

    with pytest.raises(Stopped), written_beside(path) as beside:
        beside.write_bytes(b"half")
        assert path.read_bytes() == b"good"
        raise Stopped
    assert path.read_bytes() == b"good"
    assert [p.name for p in tmp_path.iterdir()] == ["a.png"]


def test_a_failing_encoder_leaves_the_existing_file(tmp_path):
    path = tmp_path / "a.exr"
    image().save(path)
    before = path.read_bytes()
    with pytest.raises(PrevisError, match=r"a\.exr: cannot be written: "):
        save_image(Image(np.zeros((0, 4, 3)), np.zeros((0, 4)), np.zeros((0, 4))), path)
    assert path.read_bytes() == before
    assert [p.name for p in tmp_path.iterdir()] == ["a.exr"]


@pytest.mark.skipif(os.name != "posix", reason="permissions of POSIX")
def test_files_get_the_usual_permissions(tmp_path):
    umask = os.umask(0o027)
    try:
        image().save(tmp_path / "a.png")
    finally:
        os.umask(umask)
    assert stat.S_IMODE((tmp_path / "a.png").stat().st_mode) == 0o640


def test_unicode_and_spaces_in_names(tmp_path):
    path = tmp_path / "Ärger mit 雲.png"
    image().save(path)
    assert load_color(path)[0].shape == (6, 9, 3)


def test_grey_pictures_are_repeated(tmp_path):
    buffer = oiio.ImageBuf(oiio.ImageSpec(4, 3, 1, oiio.UINT8))
    oiio.ImageBufAlgo.fill(buffer, [0.5])
    buffer.write(str(tmp_path / "grey.png"))
    colour, _ = load_color(tmp_path / "grey.png")
    assert colour.shape == (3, 4, 3)
    np.testing.assert_allclose(colour, 0.5, atol=1 / 255)


@pytest.mark.parametrize("content", [None, b"", b"not a picture"])
def test_pictures_that_cannot_be_read_are_named(content, tmp_path):
    path = tmp_path / "a.png"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(PrevisError, match=r"a\.png: ") as error:
        load_color(path)
    assert "\n" not in str(error.value)


# --- OpenColorIO --------------------------------------------------------------------------------------------------


@pytest.fixture
def built_in(monkeypatch):
    monkeypatch.delenv("OCIO", raising=False)


def interpolated(lut: DisplayLut, colors: np.ndarray) -> np.ndarray:
    """What the lattice says of colours (N, 3): tetrahedral, written apart from the shader that does it."""
    last = len(lut.values) - 1
    level = np.clip(colors.astype(float), 0.0, lut.maximum)
    position = last * np.log1p(np.sqrt(level / lut.offset)) / np.log1p(np.sqrt(lut.maximum / lut.offset))
    node = np.minimum(position.astype(int), last - 1)
    fraction = position - node
    order = np.argsort(-fraction, axis=1)
    steps = [np.zeros_like(node)]
    for k in range(3):
        step = steps[-1].copy()
        step[np.arange(len(step)), order[:, k]] = 1
        steps.append(step)
    falling = np.take_along_axis(fraction, order, 1)
    ends = np.concatenate([np.ones((len(node), 1)), falling, np.zeros((len(node), 1))], axis=1)
    total = np.zeros((len(node), 3))
    for k, step in enumerate(steps):
        r, g, b = (node + step).T
        total += (ends[:, k] - ends[:, k + 1])[:, None] * lut.values[b, g, r]
    return total.clip(0.0, 1.0)


def test_the_built_in_config_says_what_it_offers(built_in):
    found = color_views()
    assert found.config == "ocio://default"
    assert found.default_display in found.displays
    assert found.default_view in found.displays[found.default_display]
    assert all(found.default_views[d] in views for d, views in found.displays.items())
    assert found.chosen() == found.chosen("", "") == (found.default_display, found.default_view)


def test_a_view_is_picked_by_name(built_in):
    found, ramp = color_views(), np.linspace(0.0, 2.0, 24, dtype=np.float32).reshape(1, 8, 3)
    default = display(ramp, 0.0, "openColorIO")
    named = display(ramp, 0.0, "openColorIO", found.default_display, found.default_view)
    np.testing.assert_array_equal(default, named)
    raw = display(ramp, 0.0, "openColorIO", ocio_view="Raw")
    np.testing.assert_allclose(raw, ramp.clip(0.0, 1.0), atol=1e-6)


@pytest.mark.parametrize(
    ("names", "message"), [(("tv", None), "no display 'tv'; it has sRGB"), ((None, "nice"), "no view 'nice'; it has ")]
)
def test_names_that_the_config_does_not_have(built_in, names, message):
    for call in (lambda: display(np.zeros((1, 1, 3)), 0.0, "openColorIO", *names), lambda: bake_lut(*names)):
        with pytest.raises(PrevisError, match=message) as error:
            call()
        assert "\n" not in str(error.value)


def test_the_view_reaches_the_file(built_in, tmp_path):
    made = image()
    made.save(tmp_path / "a.png", 0.5, "openColorIO", ocio_view="Raw")
    stored, _ = load_color(tmp_path / "a.png")
    np.testing.assert_allclose(stored, (made.color * 2.0**0.5).clip(0.0, 1.0), atol=0.5 / 255 + 1e-5)


def test_another_config_takes_the_place_of_the_built_in_one(built_in, monkeypatch, tmp_path):
    before = color_views()
    monkeypatch.setenv("OCIO", str(tmp_path / "none.ocio"))
    with pytest.raises(PrevisError, match=r"none\.ocio"):
        color_views()
    monkeypatch.delenv("OCIO")
    assert color_views() == before


@pytest.mark.parametrize(("view", "bound"), [(None, 1.0), ("Un-tone-mapped", 0.5), ("Raw", 0.6)])
def test_the_lattice_of_a_view(built_in, view, bound):
    random = np.random.default_rng(3)
    hue, saturation = random.random((30_000, 3)), random.random((30_000, 1))
    tint = 1.0 - saturation + saturation * hue / hue.max(axis=1, keepdims=True)
    colors = (2.0 ** random.uniform(-12.0, 8.0, (30_000, 1)) * tint).astype(np.float32)
    truth = display(colors[None], 0.0, "openColorIO", ocio_view=view)[0]
    error = 255.0 * np.abs(interpolated(bake_lut(ocio_view=view), colors) - truth)
    assert error.max() < bound
    assert error.mean() < 0.1


def test_a_lattice_is_baked_once(built_in):
    assert bake_lut(size=5) is bake_lut(*color_views().chosen(), size=5)
    assert bake_lut(size=5).values.shape == (5, 5, 5, 3)
    assert not bake_lut(size=5).values.flags.writeable
