"""The bench without a renderer: fronts, turns, variants, records and tables."""

import csv
import io
import math
import re
from pathlib import Path

import numpy as np
import pytest

from previs.bench import media, records, report, run
from previs.bench.tables import Table, percent, ratio
from previs.description import Volume


def dominated(points: list[tuple[float, float]], i: int) -> bool:
    """By definition: another point is no worse in both and better in one."""
    x, y = points[i]
    return any(a <= x and b <= y and (a < x or b < y) for a, b in points)


@pytest.mark.parametrize("seed", range(8))
def test_the_front_is_what_no_point_beats(seed: int) -> None:
    points = [(float(a), float(b)) for a, b in np.random.default_rng(seed).integers(0, 12, (40, 2))]
    front = run.pareto_front(points)
    assert {points[i] for i in front} == {points[i] for i in range(len(points)) if not dominated(points, i)}
    assert len({points[i] for i in front}) == len(front)
    costs = [points[i] for i in front]
    assert costs == sorted(costs) and [e for _, e in costs] == sorted((e for _, e in costs), reverse=True)


def test_fronts_of_few_points() -> None:
    assert run.pareto_front([]) == []
    assert run.pareto_front([(1.0, 1.0), (1.0, 1.0)]) == [0]
    assert run.pareto_front([(2.0, 1.0), (1.0, 2.0), (1.0, 3.0)]) == [1, 0]


def test_all_take_turns_and_the_first_turn_does_not_count() -> None:
    calls = []

    def one(item: int, turn: int) -> int:
        calls.append((turn, item))
        return 10 * turn + item

    assert run.in_turns(3, 2, one) == [[10, 20], [11, 21], [12, 22]]
    assert calls == [(turn, item) for turn in range(3) for item in range(3)]


def test_a_spread_is_the_median_and_the_quartiles() -> None:
    assert run.Spread.of([4.0, 1.0, 2.0, 3.0, 100.0]) == run.Spread(3.0, 2.0, 4.0)
    assert run.Spread.of([7.0]) == run.Spread(7.0, 7.0, 7.0)


def test_variants_are_all_combinations_and_a_march_stores_nothing() -> None:
    found = run.variants(["tfm", "march"], [6, 14], [0, 128])
    assert [v.name for v in found] == [
        "tfm 6",
        "tfm 6, 128 steps",
        "tfm 14",
        "tfm 14, 128 steps",
        "march",
        "march, 128 steps",
    ]
    assert found[1].settings == {"transmittance": "tfm", "coefficients": 6, "steps": 128, "light_steps": 128}
    assert found[4].settings == {"transmittance": "march"}


def test_other_knobs_make_families_of_their_own() -> None:
    found = run.variants(["tfm", "march"], [6, 14], [0], {"map_filter": ["blend", "nearest"]})
    assert [(v.name, v.family) for v in found] == [
        ("tfm 6", "tfm"),
        ("tfm 14", "tfm"),
        ("tfm 6, map_filter nearest", "tfm, map_filter nearest"),
        ("tfm 14, map_filter nearest", "tfm, map_filter nearest"),
        ("march", "march"),
    ]
    assert found[2].settings == {"transmittance": "tfm", "coefficients": 6, "map_filter": "nearest"}
    with pytest.raises(ValueError, match="no knob 'filter'"):
        run.variants(["tfm"], [6], [0], {"filter": ["blend"]})


@pytest.mark.parametrize(
    ("methods", "counts", "steps"), [(["none"], [6], [0]), (["tfm"], [5], [0]), (["tfm"], [6], [-1])]
)
def test_variants_of_values_that_no_knob_takes(methods, counts, steps) -> None:
    with pytest.raises(ValueError, match="is not"):
        run.variants(methods, counts, steps)


def test_shipped_scenes_are_there() -> None:
    assert [path.stem for path in run.shipped_stages()] == list(run.SHIPPED)
    assert all(path.is_file() for path in run.shipped_stages())


def test_stages_of_one_name_are_told_apart() -> None:
    assert report.names_of(["a/x.usda", "b/x.usda", "y.usda", "c/x.vdb"]) == ["x", "x-2", "y", "x-3"]


def test_what_is_featured_was_measured() -> None:
    for counts, steps in (((2, 6, 10, 14), (0, 128)), ((2, 4), (64,)), ((8,), (64, 0))):
        options = report.Options(("tfm", "march"), counts, steps)
        assert {v.name for v in options.featured()} <= {v.name for v in options.variants()}
    assert [v.name for v in report.Options(("tfm",)).featured()] == ["tfm 6", "tfm 14"]


def test_numbers_that_are_not_finite_can_be_written() -> None:
    assert [records.plain(v) for v in (math.inf, -math.inf, 1.5, 3, None, "a")] == ["inf", "-inf", 1.5, 3, None, "a"]


def test_csv_has_every_column_and_quotes_names() -> None:
    row = dict.fromkeys(records.COLUMNS)
    row |= {"variant": "tfm 6, 128 steps", "psnr": math.inf, "default": True}
    [header, cells] = csv.reader(io.StringIO(records.csv_text([row])))
    told = dict(zip(header, cells, strict=True))
    assert header == list(records.COLUMNS)
    assert (told["variant"], told["psnr"], told["default"], told["ssim"]) == ("tfm 6, 128 steps", "inf", "true", "")


TABLE = Table("A & B", ("name", "value"), (("x|y", "1"), ("<b>", "2")), note="of x < y", marked=frozenset({1}))


def test_a_table_in_markdown() -> None:
    lines = TABLE.markdown().splitlines()
    assert lines == ["**A & B**", "", "of x < y", "", "| name | value |", "|---|--:|", "| x\\|y | 1 |", "| <b> | 2 |"]


def test_a_table_in_html() -> None:
    text = TABLE.html()
    assert "<h3>A &amp; B</h3>" in text and "of x &lt; y" in text
    assert '<tr class="m"><td class="w">&lt;b&gt;</td><td class="n">2</td></tr>' in text


def test_a_row_that_does_not_fit_its_header() -> None:
    with pytest.raises(ValueError, match="3 cells"):
        Table("T", ("a", "b"), (("1", "2", "3"),))


def test_numbers_in_tables() -> None:
    assert [percent(v) for v in (None, 0.00123, 0.0999, 0.25, 3.0)] == ["–", "0.12 %", "9.99 %", "25.0 %", "300 %"]
    assert ratio(1.234) == "1.23×"
    assert ratio(12.34, 9.9, 120.0) == "12.3× (9.90–120)"


def test_the_media_of_the_papers() -> None:
    for made in (media.smoke(), media.solid()):
        assert made.shape == (media.SIDE,) * 3 and made.dtype == np.float32
        assert (float(made.min()), float(made.max())) == (0.0, 1.0)
        # Nothing ends at the box.
        assert not any(np.take(made, [0, -1], axis).any() for axis in range(3))
    assert set(np.unique(media.solid())) == {0.0, 1.0}
    assert 0.05 < media.solid().mean() < 0.5


def test_the_deepest_way_through_a_block() -> None:
    from previs import Scene

    density = np.zeros((24, 24, 24), np.float32)
    density[4:20, 4:20, 4:20] = 0.5
    with Scene() as scene:
        scene.add_volume("/V", density, bounds=((0, 0, 0), (24, 24, 24)))
        volume: Volume = scene.describe().volumes["/V"]
    assert media.deepest_way(volume, (0, 0, -2)) == pytest.approx(16 * 0.5, rel=0.03)
    assert media.deepest_way(volume, (1, 1, 0)) == pytest.approx(16 * math.sqrt(2) * 0.5, rel=0.05)


def test_the_optical_depth_of_a_made_scene() -> None:
    with media.made_scene(media.solid(), 7.0, 0.5) as scene:
        volume = scene.describe().volumes[media.VOLUME]
        assert media.deepest_way(volume, media.DIRECTION) * max(volume.medium.extinction) == pytest.approx(
            7.0, rel=1e-5
        )


def test_only_the_plots_need_matplotlib() -> None:
    """The hard cases, and what the tests use, run without it."""
    folder = Path(run.__file__).parent
    users = {
        p.name for p in folder.rglob("*.py") if re.search(r"^\s*(from|import) matplotlib", p.read_text("utf-8"), re.M)
    }
    assert users == {"plots.py"}
