"""The layout of atlases: nobody's tiles overlap, and whoever can stay stays."""

from hypothesis import given, settings
from hypothesis import strategies as st

from previs.render.atlas import AtlasLayout, lay_out

TEXTURE, MEMORY = 1024, 2**22


def layout(previous: AtlasLayout | None, wanted: dict[str, int], size: int = 64) -> AtlasLayout:
    return lay_out(previous, list(wanted.items()), size, size * size * 4, TEXTURE, MEMORY)


def check(made: AtlasLayout, wanted: dict[str, int]) -> None:
    tiles = [t for span in made.spans.values() for t in span]
    assert len(tiles) == len(set(tiles))
    assert all(t < made.capacity for t in tiles)
    assert {k: len(made.spans[k]) for k in wanted} == wanted
    width, height = made.extent
    assert width <= TEXTURE and height <= TEXTURE
    for tile in tiles:
        x, y = made.corner(tile)
        assert x + made.size <= width and y + made.size <= height


WANTED = st.dictionaries(st.sampled_from([f"/Light{i}" for i in range(40)]), st.sampled_from([1, 2, 6]), max_size=30)


@given(st.lists(st.tuples(WANTED, st.sampled_from([64, 64, 64, 48, 32])), min_size=1, max_size=12))
@settings(deadline=None)
def test_whatever_comes_and_goes(steps) -> None:
    """Tiles never overlap and lie inside; the atlas is not far larger than what it holds."""
    made = None
    for wanted, size in steps:
        made = layout(made, wanted, size)
        check(made, wanted)
        used = sum(len(span) for span in made.spans.values())
        assert made.capacity <= 8 * max(used, 1) + 2 * made.columns


def test_who_stays_keeps_its_tiles() -> None:
    """In whatever order they are named, and though others come and go."""
    first = layout(None, {"a": 1, "b": 6, "c": 2})
    second = layout(first, {"c": 2, "new": 6, "a": 1})
    assert (second.spans["a"], second.spans["c"]) == (first.spans["a"], first.spans["c"])
    assert second.spans["b"] == first.spans["b"]
    third = layout(second, {"b": 6, "new": 6})
    assert third.spans["b"] == first.spans["b"]
    assert third.spans["new"] == second.spans["new"]


def test_another_number_of_tiles_moves() -> None:
    first = layout(None, {"a": 1, "b": 1})
    second = layout(first, {"a": 6, "b": 1})
    assert second.spans["b"] == first.spans["b"]
    assert len(second.spans["a"]) == 6


def test_the_longest_unused_gives_way_first() -> None:
    """Before the atlas grows."""
    made = layout(None, {"a": 1, "b": 1, "c": 1, "d": 1})
    assert made.capacity == 4
    made = layout(made, {"a": 1, "c": 1, "d": 1})
    made = layout(made, {"a": 1, "d": 1})
    made = layout(made, {"a": 1, "d": 1, "e": 1})
    assert "b" not in made.spans and "c" in made.spans
    made = layout(made, {"a": 1, "d": 1, "e": 1, "f": 1, "g": 1})
    assert made.capacity == 8


def test_tiles_that_fit_only_side_by_side_are_laid_out_anew() -> None:
    """Sixteen tiles in all; single ones in the way of six in a row."""
    owners = {f"o{i}": 1 for i in range(16)}
    made = layout(None, owners, 256)
    made = layout(made, {f"o{i}": 1 for i in (2, 5, 8, 11, 14)}, 256)
    wanted = {**{f"o{i}": 1 for i in (2, 5, 8, 11, 14)}, "cube": 6}
    check(layout(made, wanted, 256), wanted)


def test_a_large_atlas_shrinks_when_hardly_anything_is_left() -> None:
    made = layout(None, {f"o{i}": 6 for i in range(30)}, 32)
    large = made.capacity
    for number in range(40):
        made = layout(made, {f"n{number}": 1}, 32)
    assert made.capacity < large


def test_another_size_begins_anew() -> None:
    made = layout(layout(None, {"a": 1, "b": 1}), {"b": 1}, 32)
    assert dict(made.spans) == {"b": range(1)}
