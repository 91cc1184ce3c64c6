"""``previs bench --speed`` without OpenGL: fits, the search for equal error, what is compared, and the tables."""

import csv
import io
import math

import numpy as np
import pytest
from building import box, camera, distant, index_of, point, scene, smooth_noise, spot, volume

from previs import Medium, Settings
from previs.bench.run import Spread, Subject, Variant
from previs.bench.speed import clock, peer, records, scaling, ways
from previs.bench.speed.accuracy import equal_error
from previs.bench.speed.clock import FrameTimes, Taken
from previs.bench.speed.scenes import Measured, SceneSpeed
from previs.meter import ErrorPart, Estimate
from previs.settings import BY_NAME

# --- fits -------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("exponent", [-1.0, 0.0, 0.5, 3.0])
def test_a_power_law_is_found_exactly(exponent):
    sizes = [1.0, 3.0, 10.0, 40.0]
    fit = scaling.fit_power_law(sizes, [0.25 * s**exponent for s in sizes])
    assert fit.exponent == pytest.approx(exponent, abs=1e-12)
    assert fit.factor == pytest.approx(0.25) and fit.error == pytest.approx(0.0, abs=1e-9)


def test_the_standard_error_is_that_of_repeated_fits():
    random, sizes = np.random.default_rng(0), 2.0 ** np.arange(8)
    fits = [scaling.fit_power_law(sizes, sizes**0.7 * np.exp(random.normal(0, 0.1, 8))) for _ in range(800)]
    found = np.std([f.exponent for f in fits])
    assert math.sqrt(np.mean([f.error**2 for f in fits])) == pytest.approx(found, rel=0.1)
    assert np.mean([f.exponent for f in fits]) == pytest.approx(0.7, abs=0.01)


def test_two_sizes_have_an_exponent_without_an_error():
    fit = scaling.fit_power_law([1, 10], [2, 20])
    assert fit.exponent == pytest.approx(1.0) and math.isnan(fit.error) and str(fit) == "1.00"
    assert str(scaling.Fit(0.987, 0.123, 1.0)) == "0.99 ± 0.12"


@pytest.mark.parametrize(
    ("sizes", "times"), [([1.0], [1.0]), ([2.0, 2.0], [1.0, 2.0]), ([1.0, 2.0], [0.0, 1.0]), ([0, 1, 2], [1, 1, 1])]
)
def test_what_has_no_power_law_is_said(sizes, times):
    with pytest.raises(ValueError, match="a power law"):
        scaling.fit_power_law(sizes, times)


def test_the_cloud_has_one_shape_at_all_sizes():
    fine, coarse = scaling.fractal_cloud(64), scaling.fractal_cloud(16)
    means = fine.reshape(16, 4, 16, 4, 16, 4).mean(axis=(1, 3, 5))
    assert np.abs(means - coarse).mean() < 0.02 and fine.dtype == np.float32
    assert (fine > 0).mean() == pytest.approx((coarse > 0).mean(), abs=0.03)
    assert 0.1 < (fine > 0).mean() < 0.5 and fine.min() == 0.0 and fine.max() == 1.0
    faces = [np.take(fine, end, axis) for axis in range(3) for end in (0, -1)]
    assert not any(face.any() for face in faces)
    assert not np.array_equal(fine, scaling.fractal_cloud(64, seed=2))


# --- equal error ------------------------------------------------------------------------------------------------------


def errors_of(table):
    asked = []

    def error_at(steps):
        asked.append(steps)
        return Estimate(table[steps], 0.9 * table[steps], 1.1 * table[steps])

    return error_at, asked


def test_the_least_steps_that_are_good_enough_are_taken():
    error_at, asked = errors_of({16: 0.1, 24: 0.05, 32: 0.02, 48: 0.001})
    found = equal_error(error_at, 0.02, (16, 24, 32, 48))
    assert (found.steps, found.error.value, found.reached) == (32, 0.02, True)
    assert asked == [16, 24, 32] and [s for s, _ in found.tried] == asked


def test_a_march_that_is_good_enough_at_once_is_the_first():
    error_at, asked = errors_of({16: 0.01})
    assert equal_error(error_at, 0.5, (16, 24)).steps == 16 and asked == [16]


def test_where_no_march_is_good_enough_the_finest_is_given_and_said():
    error_at, asked = errors_of({16: 0.1, 24: 0.2})
    found = equal_error(error_at, 0.0, (16, 24))
    assert (found.steps, found.reached) == (24, False) and asked == [16, 24]


# --- what is compared -------------------------------------------------------------------------------------------------


def test_only_knobs_that_there_are_are_turned_off():
    off = ways.accelerators()
    assert set(off) <= set(BY_NAME) and set(off) <= set(ways.OFF)
    Settings(**off)
    for steps in ways.LADDER:
        settings = Settings(**ways.plain(steps))
        assert (settings.transmittance, settings.steps, settings.light_steps) == ("march", steps, steps)
        assert all(settings[name] == value for name, value in off.items())


def test_an_accelerator_that_is_off_already_is_not_left_out_again():
    off = ways.accelerators()
    names = [v.name for v in ways.ways(Settings(**off))]
    assert not [n for n in names if n.startswith("without ")] and ways.ALL_OFF not in names
    on = [v for v in ways.ways(Settings()) if v.family == "without"]
    assert [v.settings for v in on] == [{n: v} for n, v in off.items() if BY_NAME[n].default != v]
    more = [v for v in ways.ways(Settings()) if v.family == "with"]
    assert [v.settings for v in more] == [
        {n: value} for n, values in ways.ON.items() if n in off and BY_NAME[n].default == off[n] for value in values
    ]
    assert ways.ways(Settings())[0] == Variant("default", {}, "default")


def test_quality_presets_are_compared_but_for_the_one_that_is_the_default():
    assert [v.name for v in ways.ways(Settings()) if v.family == "quality"] == ["draft", "preview"]
    assert "final" in [v.name for v in ways.ways(Settings(coefficients=14))]


def test_curves_stand_in_for_slices():
    found = [v for v in ways.ways(Settings()) if v.family == "curve"]
    assert [v.name for v in found] == [f"{m} {n}" for m, n in ways.CURVES]
    assert all(v.settings["transmittance"] != "slices" for v in found)
    assert not [v for v in ways.ways(Settings(transmittance="tfm")) if v.family == "curve"]


def test_light_that_is_marched_already_is_not_marched_again():
    names = [v.name for v in ways.ways(Settings(transmittance="march"))]
    assert "all off, light marched" not in names
    assert "all off, light marched" in [v.name for v in ways.ways(Settings())]


# --- moves ------------------------------------------------------------------------------------------------------------


def test_the_camera_goes_around_the_volumes():
    values = smooth_noise((6, 6, 6))
    description = scene(volume(values, Medium(), np.eye(4)), distant((0, -1, 0)))
    view = camera((0.0, 0.0, 5.0))
    moved = clock.moved_camera(view, description)
    before, after = view.camera_to_world[3, :3], moved.camera_to_world[3, :3]
    assert np.linalg.norm(after) == pytest.approx(5.0) and after[1] == pytest.approx(0.0)
    assert np.linalg.norm(after - before) == pytest.approx(2 * 5.0 * math.sin(math.radians(1.0)), rel=1e-6)
    assert moved.parts() != view.parts()


def test_the_light_that_moves_is_the_strongest_that_casts_shadows():
    fill = point((0, 3, 0), (9.0, 9.0, 9.0), path="/Fill", casts_shadows=False)
    key, rim = point((1, 2, 0), (2.0, 2.0, 2.0), path="/Key"), spot((0, 3, 1), (0, 0, 0), path="/Rim")
    description = scene(box(Medium()), fill, key, rim)
    assert clock.main_light(description).path == "/Key"
    index = index_of(description)
    before = {path: dict(entry.versions) for path, entry in index.lights.items()}
    index.update(clock.moved_light(description))
    changed = [p for p, entry in index.lights.items() if dict(entry.versions) != before[p]]
    assert changed == ["/Key"]
    assert clock.moved_light(scene(box(Medium()))) is None


# --- what VTK draws ---------------------------------------------------------------------------------------------------


def test_what_both_can_draw_is_grey_and_under_one_sun():
    medium = Medium(extinction=(1.0, 2.0, 3.0), albedo=(0.2, 0.4, 0.6), emission=(1, 1, 1))
    given = scene(box(medium), volume(smooth_noise((5, 5, 5)), medium, path="/V"), point((0, 4, 0)))
    reduced, found, direction = peer.common_scene(given)
    assert list(reduced.volumes) == ["/V"] and not reduced.meshes
    assert found.medium.extinction == (2.0,) * 3 and found.medium.albedo == pytest.approx((0.4,) * 3)
    assert not found.medium.emits
    [light] = reduced.lights.values()
    assert light.kind == "distant"
    np.testing.assert_allclose(light.direction, direction, atol=1e-9)
    np.testing.assert_allclose(direction, (0.0, -1.0, 0.0), atol=0.2)
    assert peer.common_scene(scene(box(medium))) is None


def test_the_best_scale_is_that_of_least_squares():
    truth, weight = np.random.default_rng(0).random((50, 3)), np.full(50, 2.0)
    assert peer.best_scale(0.25 * truth, truth, weight) == pytest.approx(4.0)
    noisy = truth + np.random.default_rng(1).normal(0, 0.1, truth.shape)
    best = peer.best_scale(noisy, truth, weight)
    assert all(
        np.sum((best * noisy - truth) ** 2) <= np.sum((s * noisy - truth) ** 2) for s in (0.9 * best, 1.1 * best)
    )
    assert peer.best_scale(np.zeros((4, 3)), truth[:4], weight[:4]) == 0.0


# --- tables -----------------------------------------------------------------------------------------------------------


def error_part(value: float) -> ErrorPart:
    estimate = Estimate(value, 0.8 * value, 1.2 * value)
    return ErrorPart(estimate, estimate, Estimate(40.0, 39.0, 41.0), Estimate(0.0, -value, value))


def turn(whole: float, floor: float, moves: bool = True) -> FrameTimes:
    move = Taken(0.5 * whole, whole) if moves else None
    return FrameTimes(Taken(whole, 2.0 * whole), move, None, Taken(floor, floor))


@pytest.fixture
def measured() -> SceneSpeed:
    default = Measured(
        Variant("default", {}, "default"),
        Settings(),
        (turn(1.0, 0.1), turn(2.0, 0.1), turn(3.0, 0.3)),
        error_part(0.01),
        passes={"march": 0.75, "composite": 0.01},
    )
    plain = Measured(
        Variant("brute force, 48 steps", ways.plain(48), "plain"),
        Settings(**ways.plain(48)),
        (turn(30.0, 0.1, moves=False),),
        error_part(0.008),
        estimated=True,
    )
    error_at, _ = errors_of({32: 0.02, 48: 0.008})
    floor = tuple(t.floor for t in (*default.turns, *plain.turns))
    truth = {"steps": 2048, "light_steps": 0, "pixels": 64, "floor_steps": 100}
    equal = equal_error(error_at, 0.01, (32, 48))
    return SceneSpeed("made", "made.usda", (64, 36), (default, plain), floor, equal, truth)


def test_ratios_are_taken_within_a_turn(measured):
    default = measured.default
    assert default.times("whole") == Spread(2.0, 1.5, 2.5) and default.times("whole", "wall").median == 4.0
    assert default.over_floor("whole") == Spread.of([10.0, 20.0, 10.0])
    assert default.times("light") is None and default.over_floor("light") is None
    assert measured.plain.times("camera") is None and measured.way("none") is None


def test_rows_and_csv_hold_the_same(measured):
    rows = records.rows_of(measured)
    assert [r["way"] for r in rows] == ["default", "brute force, 48 steps", "floor"]
    assert all(list(r) == list(records.COLUMNS) for r in rows)
    default, plain, floor = rows
    assert (default["speedup"], plain["speedup"], floor["speedup"]) == (15.0, 1.0, None)
    assert plain["estimated"] and "transmittance=march" in plain["settings"] and default["settings"] == ""
    assert floor["mean_relative_error"] is None and floor["whole_process"] == pytest.approx(0.1)
    assert (default["mean_relative_error_low"], default["mean_relative_error_high"]) == pytest.approx((0.008, 0.012))
    [first, *_] = list(csv.DictReader(io.StringIO(records.csv_text(rows))))
    assert first["light_process"] == "" and first["estimated"] == "false" and float(first["whole_process"]) == 2.0


def test_a_scene_for_json_says_what_equal_error_took(measured):
    record = records.scene_record(measured)
    assert record["equal_error"] == {"steps": 48, "reached": True, "tried": [[32, 0.02], [48, 0.008]]}
    assert record["passes"] == {"default": {"march": 0.75, "composite": 0.01}}


def test_the_tables_read_well(measured):
    report = pytest.importorskip("previs.bench.speed.report", reason="needs matplotlib")
    table = report.scene_table(measured)
    assert table.rows[0][1] == "2.00 s (4.00)" and table.rows[0][2] == "1.00 s (2.00)" and table.rows[0][3] == "–"
    assert table.rows[0][6] == "15.0×" and table.rows[0][7] == "1.00 % (0.80 % to 1.20 %)"
    assert table.rows[1][0] == "brute force, 48 steps (estimated)" and table.rows[2][0] == "floor, 100 steps"
    assert "48 steps" in table.note
    assert report.passes_table(measured).rows == (("default", "0.750", "0.010"),)
    text = report.headline([measured])
    assert "10.0× the time" in text and "15.0×" in text and "1.00 %" in text
    fit = scaling.fit_power_law([1, 2, 4], [1, 2, 4])
    series = scaling.Series("default: whole frame", (1.0, 2.0, 4.0), tuple(Spread.of([n]) for n in (1, 2, 4)), fit)
    found = scaling.Scaling("lights", "spots", (series,), (8,))
    assert report.scaling_table([found]).rows[0][-1] == "1.00 ± 0.00"
    assert records.scaling_record(found)["series"][0]["fit"]["exponent"] == pytest.approx(1.0)
    failed = report.peer_table([peer.PeerResult("made", "VTK", failure="no device")])
    assert failed.rows[0][2] == "failed: no device"


def test_a_sweep_stops_where_it_would_take_too_long(monkeypatch):
    class Watch:
        def __init__(self, renderer, subject):
            self.size = subject

        def __enter__(self):
            return self

        def __exit__(self, *_):
            pass

        def settings(self, values):
            return values

        def whole(self, settings):
            return Taken(float(self.size), float(self.size))

        def camera_move(self, settings):
            return Taken(0.5 * self.size, 0.5 * self.size)

    class Forgetful:
        def forget_scene(self):
            pass

    class Context:
        def __init__(self, size):
            self.size = size

        def __enter__(self):
            return self.size

        def __exit__(self, *_):
            pass

    monkeypatch.setattr(scaling, "Stopwatch", Watch)
    sweep = scaling.Sweep("made", "things", (1, 2, 4, 8, 16), lambda size, width: Context(size))
    [found] = scaling.scaling(Forgetful(), [sweep], 32, 1, limit=7.0)
    assert found.left_out == (8, 16)
    assert [s.name for s in found.series][:2] == ["default: whole frame", "default: camera move"]
    for series in found.series:
        assert series.amounts == (1.0, 2.0, 4.0) and series.fit.exponent == pytest.approx(1.0)


def test_every_sweep_has_a_name_that_the_command_knows():
    from previs.commands.bench import _sweeps

    assert _sweeps(",".join(scaling.SWEEPS)) == list(scaling.SWEEPS) and _sweeps("none") == []
    assert [s.name for s in scaling.sweeps(True)] == list(scaling.SWEEPS)
    for quick, full in zip(scaling.sweeps(False), scaling.sweeps(True), strict=True):
        assert len(quick.sizes) >= 3 and max(full.sizes) > max(quick.sizes)
        assert list(full.sizes) == sorted(full.sizes)


def test_a_subject_keeps_its_settings_but_one_sample_per_pixel():
    index = index_of(scene(box(Medium()), distant((0, -1, 0))))
    subject = Subject("made", "", index, camera((0, 0, 5)), (8, 4), Settings(antialias=4, steps=33))
    watch = object.__new__(clock.Stopwatch)
    watch.subject = subject
    settings = watch.settings({"coefficients": 4})
    assert (settings.antialias, settings.steps, settings.coefficients) == (1, 33, 4)
