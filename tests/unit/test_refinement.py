"""The ladder of quality: how small drafts are, which levels follow, and that it does not waver."""

import pytest

from previs import Settings
from previs.ui.refinement import DIVISORS, DRAFT_SECONDS, Level, Pace, draft_settings, final

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
    assert seconds / level.divisor**2 <= DRAFT_SECONDS
    larger = [d for d in DIVISORS if d < level.divisor]
    assert not larger or seconds / larger[-1] ** 2 > DRAFT_SECONDS


def test_the_slowest_scene_gets_the_smallest_draft():
    assert paced(100.0).first(*SIZE, Settings()).divisor == DIVISORS[-1]


def test_where_the_full_picture_is_quick_there_is_no_ladder():
    level = paced(0.001, 0.01).first(*SIZE, Settings())
    assert level.name == "final" and level.divisor == 1


def test_the_size_does_not_follow_every_measurement():
    pace = paced(0.2)
    kept = pace.first(*SIZE, Settings()).divisor
    for factor in (1.3, 0.7, 1.2, 0.8):
        for _ in range(5):
            pace.measured(Level("draft", 1, Settings()), PIXELS, 0.2 * factor)
        assert pace.first(*SIZE, Settings()).divisor == kept
    for _ in range(10):
        pace.measured(Level("draft", 1, Settings()), PIXELS, 2.0)
    assert pace.first(*SIZE, Settings()).divisor > kept


def test_levels_follow_one_another_to_the_settings_asked_for():
    settings = Settings(coefficients=14, antialias=2)
    pace = paced(0.2)
    first = pace.first(*SIZE, settings)
    second = pace.next(first.name, *SIZE, settings)
    third = pace.next(second.name, *SIZE, settings)
    assert [first.name, second.name, third.name] == ["draft", "medium", "final"]
    assert second.settings.steps < 256 and second.divisor == 1
    assert third.settings == settings
    assert first.settings.antialias == second.settings.antialias == 1
    assert pace.next("final", *SIZE, settings) is None


def test_samples_are_for_a_picture_at_rest():
    pace = paced(0.001)
    assert pace.first(*SIZE, Settings()) == final(Settings())
    many = Settings(antialias=3)
    first = pace.first(*SIZE, many)
    assert (first.name, first.divisor, first.settings) == ("medium", 1, Settings())
    assert pace.next("medium", *SIZE, many) == final(many)
    # They count for how long the last picture takes, and so for whether one is wanted before it.
    assert paced(0.05, 0.1).next("draft", *SIZE, Settings()).name == "final"
    assert paced(0.05, 0.1).next("draft", *SIZE, many).name == "medium"


def test_a_quick_or_coarse_final_picture_needs_no_medium_one():
    assert paced(0.05, 0.1).next("draft", *SIZE, Settings()).name == "final"
    assert paced(0.5).next("draft", *SIZE, Settings(steps=32)).name == "final"


def test_drafts_ask_for_less_and_never_for_more():
    draft = draft_settings(Settings(steps=16, transmittance="march"))
    assert draft.steps == 16 and draft.transmittance == Settings().transmittance
    assert draft_settings(Settings()).steps == 48
    # The same voxels: another limit would pack them again.
    assert draft.field_memory == Settings().field_memory
    assert draft_settings(Settings(coefficients=14)).coefficients == 14


def test_sizes_of_levels_cover_the_view():
    assert Level("draft", 3, Settings()).size(640, 361) == (214, 121)
    assert final(Settings()).size(1, 1) == (1, 1)
    assert Level("draft", 8, Settings()).size(4, 4) == (1, 1)
