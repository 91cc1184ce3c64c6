"""The display pass: what a window shows is what a file would hold."""

import moderngl
import numpy as np
import pytest

from previs import io
from previs.render.display import ALARM, Compare, DisplayPass, DisplayTransform, error_colormap, error_scale

pytestmark = pytest.mark.gl

STEP = 1.0 / 255.0


@pytest.fixture(scope="module")
def show(renderer):
    """draw(a, transform, b, compare, size) → (H, W, 3) in [0, 1], rows from the top."""
    display = DisplayPass(renderer.context)

    def draw(a, transform=None, b=None, compare=None, size=None):
        # A context is entered one at a time: leaving it a second time leaves it altogether.
        with renderer.context as context:
            textures = [texture(context, p) for p in (a, b) if p is not None]
        shown = display.draw(
            textures[0],
            size or a.shape[1::-1],
            transform or DisplayTransform(dither=False),
            textures[1] if b is not None else None,
            compare or Compare(),
        )
        with renderer.context:
            pixels = np.frombuffer(shown.read(), np.uint8).reshape(*shown.size[::-1], 4)[::-1]
            for t in textures:
                t.release()
        assert (pixels[..., 3] == 255).all()
        return pixels[..., :3] / 255.0

    yield draw
    display.release()


def texture(context, picture):
    """A picture as the renderer leaves it: 32-bit float, bottom row first, not filtered."""
    rgba = np.concatenate([picture, np.full((*picture.shape[:2], 1), 0.5)], axis=-1)
    made = context.texture(picture.shape[1::-1], 4, np.ascontiguousarray(rgba[::-1], np.float32).tobytes(), dtype="f4")
    made.filter = moderngl.NEAREST, moderngl.NEAREST
    return made


def colors(count: int = 40_000, seed: int = 0, brightest: float = 8.0) -> np.ndarray:
    """Colours of every hue and saturation, over twenty stops: (count / 200, 200, 3)."""
    random = np.random.default_rng(seed)
    hue, saturation = random.random((count, 3)), random.random((count, 1))
    tint = 1.0 - saturation + saturation * hue / hue.max(axis=1, keepdims=True)
    level = 2.0 ** random.uniform(brightest - 20.0, brightest, (count, 1))
    return (level * tint).astype(np.float32).reshape(-1, 200, 3)


def rounded(values: np.ndarray) -> np.ndarray:
    return np.floor(values * 255.0 + 0.5) / 255.0


# --- one picture ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("correction", ["disabled", "sRGB"])
@pytest.mark.parametrize("stops", [0.0, -3.5, 6.0])
def test_a_picture_is_shown_as_it_is_saved(show, correction, stops):
    picture = colors(seed=1)
    shown = show(picture, DisplayTransform(stops, correction, dither=False))
    np.testing.assert_allclose(shown, io.display(picture, stops, correction), atol=0.51 * STEP)


def test_values_that_are_none_are_shown_as_in_a_file(show):
    bad = [np.nan, np.inf, -np.inf, -1.0, -0.0, 1e38, 1e-38, 0.5]
    picture = np.array([[[x, y, 0.25] for x in bad] for y in bad], np.float32)
    for correction in ("disabled", "sRGB"):
        shown = show(picture, DisplayTransform(3.0, correction, dither=False))
        np.testing.assert_allclose(shown, io.display(picture, 3.0, correction), atol=0.51 * STEP)


def test_the_default_view_is_met_to_one_step(show, monkeypatch):
    monkeypatch.delenv("OCIO", raising=False)
    picture = colors(seed=2)
    shown = show(picture, DisplayTransform(0.0, "openColorIO", dither=False))
    truth = io.display(picture, 0.0, "openColorIO")
    # 8 bits add half a step to the 0.9 of the lattice.
    assert np.abs(shown - rounded(truth)).max() <= 1.001 * STEP
    assert np.abs(shown - truth).mean() < 0.3 * STEP


def views():
    with pytest.MonkeyPatch.context() as patch:
        patch.delenv("OCIO", raising=False)
        found = io.color_views()
    return [(d, v) for d, names in found.displays.items() for v in names]


@pytest.mark.parametrize(("display", "view"), views())
def test_every_view_of_the_built_in_config_is_met(show, display, view, monkeypatch):
    monkeypatch.delenv("OCIO", raising=False)
    picture = colors(10_000, seed=3)
    shown = show(picture, DisplayTransform(-0.5, "openColorIO", display, view, dither=False))
    truth = io.display(picture, -0.5, "openColorIO", display, view)
    assert np.abs(shown - truth).max() <= 1.6 * STEP


def test_greys_and_primaries_go_through_the_view(show):
    ramp = 2.0 ** np.linspace(-10.0, 8.0, 256, dtype=np.float32)
    picture = np.stack([ramp[:, None] * np.array(c, np.float32) for c in np.ndindex(2, 2, 2)])
    shown = show(picture, DisplayTransform(0.0, "openColorIO", dither=False))
    error = np.abs(shown - io.display(picture, 0.0, "openColorIO")).max(axis=-1)
    # Greys stay grey: tetrahedral interpolation does not mix in the corners of other colours.
    assert error[-1].max() <= 0.9 * STEP
    assert np.ptp(shown[-1], axis=-1).max() <= 1.001 * STEP
    # Pure blue leaves the edge of the gamut steeply within one cell, in the two dark channels beside a full one.
    assert np.quantile(error, 0.99) <= 1.5 * STEP
    assert error.max() <= 12.0 * STEP


def test_a_name_that_the_config_does_not_have_is_refused(show):
    with pytest.raises(io.PrevisError, match="no display 'television'"):
        show(colors(200), DisplayTransform(0.0, "openColorIO", "television"))


@pytest.mark.parametrize("bad", [{"color_correction": "srgb"}, {"exposure": "auto"}, {"exposure": np.nan}])
def test_transforms_that_are_none(bad):
    with pytest.raises(ValueError, match=r"exposure|color_correction"):
        DisplayTransform(**bad)


def test_a_coarse_picture_is_interpolated(show):
    coarse = colors(400, brightest=0.0)[:2, :8]
    shown = show(coarse, DisplayTransform(0.0, "disabled", dither=False), size=(32, 8))
    x = np.clip((np.arange(32) + 0.5) / 4.0 - 0.5, 0, 7)
    y = np.clip((np.arange(8) + 0.5) / 4.0 - 0.5, 0, 1)
    rows = np.stack([np.stack([np.interp(x, np.arange(8), coarse[j, :, c]) for c in range(3)], -1) for j in range(2)])
    expected = rows[0] * (1.0 - y)[:, None, None] + rows[1] * y[:, None, None]
    np.testing.assert_allclose(shown, expected.clip(0, 1), atol=0.55 * STEP)


def test_a_broken_texel_does_not_spread(show):
    coarse = np.full((4, 4, 3), 0.5, np.float32)
    coarse[1, 1] = np.nan
    shown = show(coarse, DisplayTransform(0.0, "disabled", dither=False), size=(16, 16))
    assert shown[8:, 12:].min() > 0.49
    assert shown[5, 5].max() < 0.2


def test_dither_breaks_up_the_steps_of_a_gradient(show):
    ramp = np.broadcast_to(np.linspace(0.2, 0.21, 512, dtype=np.float32)[None, :, None], (64, 512, 3))
    truth = np.broadcast_to(io.display(ramp)[:1, :, 0], (64, 512))
    plain, dithered = (show(ramp, DisplayTransform(dither=d))[..., 0] for d in (False, True))
    assert np.abs(dithered - truth).max() <= 1.01 * STEP
    blocks = [np.abs((p - truth).reshape(8, 8, 64, 8).mean(axis=(1, 3))).max() for p in (plain, dithered)]
    assert blocks[0] > 0.4 * STEP
    assert blocks[1] < 0.1 * STEP
    black = np.zeros((8, 8, 3), np.float32)
    assert (show(black, DisplayTransform(dither=True)) == 0.0).all()
    assert (show(black + 2.0, DisplayTransform(dither=True)) == 1.0).all()


# --- two pictures -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("divider", [0.0, 0.3, 1.0])
def test_the_wipe_shows_one_on_either_side(show, divider):
    a, b = colors(2000, seed=4), colors(2000, seed=5)
    shown = show(a, b=b, compare=Compare("wipe", divider))
    edge = round(divider * 200)
    np.testing.assert_array_equal(shown[:, :edge], show(a)[:, :edge])
    np.testing.assert_array_equal(shown[:, edge:], show(b)[:, edge:])


def test_the_error_view_shows_decades(show):
    low, high = 1e-4, 1.0
    b = np.zeros((20, 100, 3), np.float32)
    b[:, 50:] = 0.5  # half of the picture is lit, at a mean of 0.5
    relative = np.array([0.0, 1e-5, 1e-4, 1e-3, 1e-2, 0.1, 1.0, 30.0])
    a = b.copy()
    a[0, 50:58, 1] += 0.5 * relative
    a[1, 0, 2] = 0.5 * 0.01  # light where there is none
    shown = show(a, b=b, compare=Compare("error", error_range=(low, high)))
    table = rounded(error_colormap())
    positions = [0.0, 0.0, 0.0, 0.25, 0.5, 0.75, 1.0, 1.0]
    for x, position in zip(range(50, 58), positions, strict=True):
        expected = table[int(position * 255 + 0.5)]
        assert np.abs(shown[0, x] - expected).max() <= 3 * STEP, position
    np.testing.assert_allclose(shown[1, 0], table[128], atol=3 * STEP)
    assert (shown[2:, :50] == 0.0).all(), "black against black is dark"


def test_a_faint_haze_does_not_count_as_lit(show):
    b = np.full((64, 64, 3), 1e-6, np.float32)
    b[:8, :8] = 1.0
    a = b.copy()
    a[0, 0] += 0.1
    shown = show(a, b=b, compare=Compare("error", error_range=(1e-4, 1.0)))
    np.testing.assert_allclose(shown[0, 0], rounded(error_colormap())[191], atol=3 * STEP)


def test_broken_values_raise_an_alarm(show):
    b = np.full((4, 4, 3), 0.5, np.float32)
    a = b.copy()
    a[0, 0, 1], a[1, 1, 2] = np.nan, np.inf
    shown = show(a, b=b, compare=Compare("error"))
    for pixel in (shown[0, 0], shown[1, 1]):
        np.testing.assert_array_equal(pixel, ALARM)
    assert np.abs(error_colormap() - ALARM).max(axis=1).min() > 0.4, "no error looks like it"
    np.testing.assert_array_equal(show(b, b=a, compare=Compare("error"))[0, 0], ALARM)


def test_against_a_black_picture_all_light_is_the_highest_error(show):
    a = np.full((2, 2, 3), 1e-6, np.float32)
    shown = show(a, b=np.zeros_like(a), compare=Compare("error"))
    np.testing.assert_allclose(shown[0, 0], rounded(error_colormap())[-1], atol=1e-6)


def test_pictures_of_two_sizes_are_compared(show):
    fine = np.broadcast_to(np.linspace(0.0, 1.0, 64, dtype=np.float32)[None, :, None], (16, 64, 3)).copy()
    coarse = fine.reshape(8, 2, 32, 2, 3).mean(axis=(1, 3))
    shown = show(coarse, b=fine, compare=Compare("error", error_range=(1e-3, 1.0)), size=(64, 16))
    np.testing.assert_allclose(shown[8, 8:56], np.broadcast_to(rounded(error_colormap())[0], (48, 3)), atol=1e-6)


def test_comparing_takes_two(show):
    with pytest.raises(ValueError, match="two pictures"):
        show(colors(200), compare=Compare("wipe"))


@pytest.mark.parametrize("bad", [{"mode": "both"}, {"error_range": (0.0, 1.0)}, {"error_range": (1.0, 1.0)}])
def test_comparisons_that_are_none(bad):
    with pytest.raises(ValueError, match=r"mode|error_range"):
        Compare(**bad)


def test_the_table_of_errors_rises_in_lightness():
    table = error_colormap()
    assert table.shape == (256, 3)
    assert ((table >= 0.0) & (table <= 1.0)).all()
    linear = np.where(table <= 0.04045, table / 12.92, ((table + 0.055) / 1.055) ** 2.4)
    assert (np.diff(linear @ [0.2126, 0.7152, 0.0722]) > 0.0).all()


def test_the_scale_names_whole_decades():
    assert error_scale((1e-4, 1.0)) == (
        (0.0, "0.01 %"),
        (0.25, "0.1 %"),
        (0.5, "1 %"),
        (0.75, "10 %"),
        (1.0, "100 %"),
    )
    assert error_scale() == error_scale(Compare().error_range)
    (first, label), *_ = error_scale((3e-3, 1.0))
    assert label == "1 %"
    assert first == pytest.approx(np.log(0.01 / 3e-3) / np.log(1.0 / 3e-3))


# --- the context ------------------------------------------------------------------------------------------------------


@pytest.fixture
def bound(renderer):
    """A bound framebuffer, with blending on and a picture to draw."""
    with renderer.context as context:
        mine = context.simple_framebuffer((7, 5))
        picture = texture(context, colors(200))
        mine.use()
        context.enable_only(moderngl.BLEND)
    yield mine, picture
    with renderer.context:
        renderer._frame.rest()
        mine.release()
        picture.release()


def assert_bound(context, framebuffer):
    with context:
        found = context.detect_framebuffer()
        assert found.glo == framebuffer.glo
        assert found.viewport == (0, 0, *framebuffer.size)
        framebuffer.clear(0.25)
        assert framebuffer.read(components=1)[0] == 64


def test_the_context_is_left_as_it_was(renderer, bound):
    mine, picture = bound
    display = DisplayPass(renderer.context)
    for size in ((200, 1), (30, 20), (31, 20)):
        display.draw(picture, size, DisplayTransform(0.0, "openColorIO"))
        assert_bound(renderer.context, mine)
        display.draw(picture, size, b=picture, compare=Compare("error"))
        assert_bound(renderer.context, mine)
    display.release()
    with renderer.context as context:
        assert context.error == "GL_NO_ERROR"


def test_a_draw_that_fails_leaves_it_too(renderer, bound, monkeypatch):
    monkeypatch.setenv("OCIO", "/nowhere.ocio")
    mine, picture = bound
    display = DisplayPass(renderer.context)
    with pytest.raises(io.PrevisError, match=r"nowhere\.ocio"):
        display.draw(picture, (200, 1), DisplayTransform(0.0, "openColorIO"))
    assert_bound(renderer.context, mine)
    display.release()
