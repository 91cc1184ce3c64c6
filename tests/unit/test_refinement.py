"""The ladder of quality: how small drafts are, which levels follow, and that it does not waver."""

import math
from itertools import pairwise

import numpy as np
import pytest
from building import sphere, volume

from previs import Medium, Settings
from previs.meter import ErrorEstimate, ErrorPart, Estimate
from previs.quality import preset
from previs.render.draws import steps_across
from previs.render.measure import converged
from previs.ui.error_text import error_hint, error_words, percent
from previs.ui.refinement import (
    COARSE_SHARE,
    DRAFT_SECONDS,
    DRAFTS,
    FINER_TEXELS,
    Level,
    Pace,
    SliceCounts,
    draft_settings,
    final,
    finer_levels,
)

SIZE = (640, 360)
PIXELS = SIZE[0] * SIZE[1]


def paced(draft: float, last: float | None = None) -> Pace:
    """A pace that has long measured these seconds per picture of the full size."""
    pace = Pace(software=True)
    for _ in range(30):
        pace.measured(Level("draft", 1, Settings()), PIXELS, draft)
        pace.measured(Level("final", 1, Settings()), PIXELS, draft * 4 if last is None else last)
    return pace


@pytest.mark.parametrize("seconds", (0.03, 0.1, 0.2, 0.5, 2.0))
def test_a_draft_is_as_large_as_it_may_be(seconds):
    level = paced(seconds).first(*SIZE, Settings())
    assert level.name == "draft"

    def expected(divisor: int, marched: int) -> float:
        return seconds * (COARSE_SHARE if marched == 4 else 1.0) / divisor**2

    taken = (level.divisor, level.settings.march_divisor)
    least = preset("draft")["march_divisor"]
    better = [d for d in DRAFTS if expected(*d) > expected(*taken)]
    assert taken in [(divisor, max(marched, least)) for divisor, marched in DRAFTS]
    assert expected(*taken) <= DRAFT_SECONDS and all(expected(*d) > DRAFT_SECONDS for d in better)


def test_surfaces_stay_sharp_longer_than_media():
    """Fewer pixels are marched before there are fewer of them."""
    level = paced(0.08).first(*SIZE, Settings())
    assert level.divisor == 1 and level.settings.march_divisor == 4
    assert paced(0.03).first(*SIZE, Settings()).settings.march_divisor == preset("draft")["march_divisor"]


def test_the_pace_of_coarser_drafts_says_that_of_finer_ones():
    pace = paced(0.08)
    for _ in range(30):
        level = pace.first(*SIZE, Settings())
        pace.measured(level, PIXELS, 0.08 * COARSE_SHARE)
    assert level.settings.march_divisor == 4 and pace.seconds("draft", PIXELS) == pytest.approx(0.08)


def test_the_slowest_scene_gets_the_smallest_draft():
    assert paced(100.0).first(*SIZE, Settings()).divisor == DRAFTS[-1][0]


def test_where_the_full_picture_is_quick_there_is_no_ladder():
    level = paced(0.001, 0.01).first(*SIZE, Settings())
    assert level.name == "final" and level.divisor == 1


def test_the_size_does_not_follow_every_measurement():
    pace = paced(0.2)
    kept = pace.first(*SIZE, Settings())
    for factor in (1.3, 0.7, 1.2, 0.8):
        for _ in range(5):
            pace.measured(Level("draft", 1, Settings()), PIXELS, 0.2 * factor)
        assert pace.first(*SIZE, Settings()) == kept
    for _ in range(10):
        pace.measured(Level("draft", 1, Settings()), PIXELS, 2.0)
    assert pace.first(*SIZE, Settings()).divisor > kept.divisor


def test_levels_follow_one_another_to_the_settings_asked_for():
    settings = Settings(coefficients=14, antialias=2)
    pace = paced(0.2)
    first = pace.first(*SIZE, settings)
    second = pace.next(first.name, *SIZE, settings)
    third = pace.next(second.name, *SIZE, settings)
    assert [first.name, second.name, third.name] == ["draft", "preview", "final"]
    assert second.settings.steps < 256 and second.divisor == 1
    assert third.settings == settings
    assert first.settings.antialias == second.settings.antialias == 1
    assert pace.next("final", *SIZE, settings) is None


def test_samples_are_for_a_picture_at_rest():
    pace = paced(0.001)
    assert pace.first(*SIZE, Settings()) == final(Settings())
    many = Settings(antialias=3)
    first = pace.first(*SIZE, many)
    assert (first.name, first.divisor, first.settings) == ("preview", 1, Settings())
    assert pace.next("preview", *SIZE, many) == final(many)
    # They count for how long the last picture takes, and so for whether one is wanted before it.
    assert paced(0.05, 0.1).next("draft", *SIZE, Settings()).name == "final"
    assert paced(0.05, 0.1).next("draft", *SIZE, many).name == "preview"


def test_a_quick_or_coarse_final_picture_needs_no_preview():
    assert paced(0.05, 0.1).next("draft", *SIZE, Settings()).name == "final"
    assert paced(0.5).next("draft", *SIZE, Settings(**preset("draft"))).name == "final"


def test_drafts_ask_for_less_and_never_for_more():
    draft = draft_settings(Settings(steps=16, transmittance="march"))
    assert draft.steps == 16 and draft.transmittance == Settings().transmittance
    assert draft_settings(Settings()).steps == preset("draft")["steps"]
    assert draft_settings(Settings()).map_filter == "nearest"
    assert draft_settings(Settings(transmittance="tfm")).transmittance == "tfm"
    # The same voxels: another limit would pack them again.
    assert draft.field_memory == Settings().field_memory
    assert draft_settings(Settings(coefficients=14)).coefficients == 14


def test_a_preview_has_the_maps_of_the_final_picture():
    """They would be made twice for every change."""
    settings = Settings(coefficients=14, map_size=512, opacity_cutoff=0.05)
    level = paced(0.5).next("draft", *SIZE, settings)
    assert level.name == "preview" and level.settings.march_divisor == 2
    for kind in ("transmittance_map", "shadow_map", "surface"):
        assert level.settings.read_by(kind) == settings.read_by(kind)
    assert level.settings.opacity_cutoff == 0.05


def test_sizes_of_levels_cover_the_view():
    assert Level("draft", 3, Settings()).size(640, 361) == (214, 121)
    assert final(Settings()).size(1, 1) == (1, 1)
    assert Level("draft", 8, Settings()).size(4, 4) == (1, 1)


# --- beyond the final level -------------------------------------------------------------------------------------------

CLOUD = volume(np.ones((8, 8, 8)), Medium(extinction=(4.0, 4.0, 4.0)))
BALL = sphere(Medium(extinction=(1.0, 1.0, 1.0)))


@pytest.mark.parametrize(
    "values", [{}, {"steps": 40}, {"steps": 900, "transmittance": "quantile"}, {"transmittance": "march"}]
)
def test_every_finer_level_has_twice_the_steps_and_the_last_is_the_truth(values):
    settings = Settings(**values)
    counts = SliceCounts(256, 56, 1)
    levels = finer_levels(settings, [CLOUD], counts)
    assert [level.number for level in levels] == list(range(1, len(levels) + 1))
    assert [level.name for level in levels] == ["finer"] * (len(levels) - 1) + ["exact"]
    steps = [settings.steps or steps_across(CLOUD, 0), *(level.settings.steps for level in levels)]
    assert all(b == 2 * a for a, b in pairwise(steps[:-1])) and steps[-2] < steps[-1] <= 2 * steps[-2]
    assert levels[-1].settings == converged(settings, [CLOUD])
    assert levels[-1].settings.transmittance == "march" and levels[-1].settings.light_steps == 0
    for before, after in pairwise([settings, *(level.settings for level in levels)]):
        assert after.opacity_cutoff < before.opacity_cutoff or after.opacity_cutoff == 1e-5
    sizes = [(x.settings.map_size, x.settings.slices) for x in levels if x.settings.transmittance == "slices"]
    if settings.transmittance == "march":
        assert not sizes
    else:
        assert all(b > a for a, b in pairwise([(counts.size, counts.slices), *sizes])), sizes
        assert sizes[-1] == (512, 112)


def test_light_space_grids_of_finer_levels_are_larger_while_there_is_room():
    found = [x.settings for x in finer_levels(Settings(steps=256), [CLOUD], SliceCounts(180, 56, 2))[:-1]]
    assert [(s.map_size, s.slices) for s in found] == [(270, 84), (360, 112)]
    many = [x.settings for x in finer_levels(Settings(), [CLOUD], SliceCounts(300, 56, 60))[:-1]]
    assert {(s.map_size, s.slices) for s in many} == {(300, 56)}
    for counts in (SliceCounts(200, 56, 2), SliceCounts(400, 140, 1), SliceCounts(64, 280, 7)):
        larger = counts.larger(2.0)
        # Slices are rounded up.
        assert counts.size < larger.size and larger.grids == counts.grids
        assert larger.size**2 * (larger.slices - 28) * larger.grids <= FINER_TEXELS
    # Without voxels there are none.
    assert {x.settings.map_size for x in finer_levels(Settings(), [BALL])[:-1]} == {0}


def test_the_way_to_the_truth_is_along_slices_whatever_maps_hold():
    for method in ("quantile", "tfm", "tfm-plain"):
        levels = finer_levels(Settings(transmittance=method), [CLOUD], SliceCounts(200, 56, 2))
        assert {x.settings.transmittance for x in levels} == {"slices", "march"}


def test_a_march_stays_a_march():
    for level in finer_levels(Settings(transmittance="march", light_steps=20), [CLOUD]):
        assert (level.settings.transmittance, level.settings.light_steps) == ("march", 0)


def test_every_sample_of_a_pixel_takes_all_steps_of_its_level():
    """The mean of jittered pictures of few steps would converge to a limit that is off."""
    one, many = (finer_levels(Settings(antialias=n), [CLOUD], SliceCounts(256, 56, 1)) for n in (1, 3))
    for a, b in zip(one, many, strict=True):
        assert b.settings == a.settings.replace(antialias=3) and b.divisor == 1


def test_the_truth_and_an_empty_stage_have_no_finer_levels():
    assert finer_levels(converged(Settings(), [CLOUD]), [CLOUD]) == ()
    assert finer_levels(Settings(), []) == ()


def test_no_level_follows_the_final_one_by_itself():
    pace = paced(0.2)
    for name in ("final", "finer", "exact"):
        assert pace.next(name, *SIZE, Settings()) is None


# --- in words ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (0.00393, "0.39"),
        (0.0123, "1.2"),
        (0.1, "10"),
        (0.5, "50"),
        (0.0000123, "0.0012"),
        (1e-9, "<0.0001"),
        (0.0, "0"),
        (math.inf, "–"),
    ],
)
def test_errors_are_read_with_two_digits(value, text):
    assert percent(value) == text


def test_the_words_of_an_error():
    mean, level = Estimate(0.004, 0.0035, 0.005), Estimate(52.3, 51.0, 54.0)
    part = ErrorPart(mean, mean, level, mean)
    none = ErrorPart(Estimate(0, 0, 0), Estimate(0, 0, 0), Estimate(math.inf, math.inf, math.inf), Estimate(0, 0, 0))
    found = ErrorEstimate(mean, mean, level, mean, part, none, 256, 2048, 0, 0.8)
    assert error_words(found) == "error 0.4 % (0.35–0.5), 52 dB"
    hint = error_hint(found)
    for words in ("0.4 % (0.35 to 0.5)", "2048 steps", "256 random pixels", "52.3 dB (51.0 to 54.0)"):
        assert words in hint
    exact = ErrorEstimate(*(getattr(none, n) for n in ("relative_rmse",) * 2), none.psnr, none.bias, none, none, 256)
    assert error_words(exact) == "error 0 %" and "PSNR" not in error_hint(exact)
