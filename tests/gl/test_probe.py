"""The probe: one ray of a light, as the renderer sees it and as it is."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from building import (
    box_mesh,
    camera,
    distant,
    index_of,
    point,
    rotation,
    scaling,
    scene,
    smooth_noise,
    sphere,
    spot,
    translation,
    volume,
)

import previs
from previs import reference as ref
from previs.bench.reference_scene import reference_scene
from previs.description import Light, Medium, SceneDescription, volume_world_bounds
from previs.render import probe as probe_module
from previs.render.method import THRESHOLD, THRESHOLD_INSIDE
from previs.render.probe import ProbeCurve, TransmittanceProbe, probe
from previs.settings import Settings

pytestmark = pytest.mark.gl

GREY = Medium(extinction=(4.0, 4.0, 4.0))
COLOURED = Medium(extinction=(2.0, 4.0, 8.0))

LIGHTS = {
    "distant": distant((1.0, -2.0, 0.5), path="/Light"),
    "point": point((3.0, 2.0, 1.0), path="/Light"),
    "point inside": point((0.2, -0.1, 0.3), path="/Light"),
    "spot": spot((0.0, 4.0, 1.0), (0.1, 0.0, 0.0), path="/Light"),
    "rect": spot((-3.0, 0.5, 0.0), (0.0, 0.0, 0.0), path="/Light", kind="rect", shaped=False),
}


def cloud(medium: Medium = GREY, size: int = 24, path: str = "/Cloud", matrix=None):
    return volume(smooth_noise((size, size, size), seed=7), medium, matrix, path)


def truth(description: SceneDescription, light: Light, found: TransmittanceProbe) -> np.ndarray:
    points = found.origin + found.distance[:, None] * found.direction
    model = reference_scene(replace(description, lights={light.path: light}))
    return ref.light_transmittance(model, model.lights[0], points)


def curve(found: TransmittanceProbe, name: str) -> ProbeCurve:
    (match,) = [c for c in found.curves if c.name == name]
    return match


def error(found: TransmittanceProbe, name: str) -> float:
    return float(np.sqrt(np.mean((curve(found, name).transmittance - found.march.transmittance) ** 2)))


# --- the truth --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", LIGHTS)
@pytest.mark.parametrize("medium", [GREY, COLOURED], ids=["grey", "coloured"])
def test_the_march_is_the_reference(renderer, kind, medium):
    description = scene(cloud(medium, matrix=rotation((1, 2, 3), 40) @ scaling(1.0, 1.3, 0.8)), LIGHTS[kind])
    found = probe(renderer, index_of(description), Settings(), "/Light", np.array([-0.1, 0.05, 0.2]))
    expected = truth(description, LIGHTS[kind], found)
    assert expected.min() < 0.7, "there is something on the way"
    # Voxels are half floats.
    np.testing.assert_allclose(found.march.transmittance, expected, atol=1e-3)


def test_the_truth_does_not_depend_on_the_settings(renderer):
    index = index_of(scene(cloud(), LIGHTS["point"]))
    fine, coarse = (probe(renderer, index, s, "/Light", np.zeros(3)) for s in (Settings(), Settings(light_steps=8)))
    np.testing.assert_array_equal(fine.march.transmittance, coarse.march.transmittance)
    assert np.abs(fine.curves[1].transmittance - coarse.curves[1].transmittance).max() > 1e-4


def test_several_volumes_multiply(renderer):
    description = scene(
        cloud(path="/A", matrix=translation(-1.5, 0, 0)),
        cloud(COLOURED, path="/B", matrix=translation(0.5, 0.1, 0)),
        sphere(Medium(extinction=(0.5, 0.4, 0.3)), 0.6, translation(2.5, 0, 0), path="/Ball"),
        distant((1.0, 0.0, 0.0)),
    )
    found = probe(renderer, index_of(description), Settings(), "/Sun", np.array([2.6, 0.2, 0.1]))
    expected = truth(description, description.lights["/Sun"], found)
    np.testing.assert_allclose(found.march.transmittance, expected, atol=1e-3)
    np.testing.assert_allclose(curve(found, "quantile, 14 depths").transmittance, expected, atol=0.03)
    assert expected[-1].max() < 0.9 * expected[len(expected) // 2].max()
    # Distances count from where the ray enters the first volume; this one starts a little before it.
    assert found.distance[0] < 0.0 < found.distance[1] - found.distance[0]
    assert np.interp(0.0, found.distance, expected[:, 0]) == pytest.approx(1.0, abs=0.01)


@pytest.mark.parametrize("kind", LIGHTS)
def test_the_ray_goes_through_the_point(renderer, kind):
    light, at = LIGHTS[kind], np.array([0.3, -0.2, 0.4])
    found = probe(renderer, index_of(scene(cloud(), light)), Settings(), "/Light", at)
    np.testing.assert_allclose(found.origin + found.picked * found.direction, at, atol=1e-9)
    assert found.distance[0] <= found.picked <= found.distance[-1]
    assert (np.diff(found.distance) > 0.0).all()
    assert np.linalg.norm(found.direction) == pytest.approx(1.0)
    if light.kind == "distant":
        np.testing.assert_allclose(found.direction, light.direction)
    else:
        np.testing.assert_allclose(found.origin, light.position, atol=1e-9)
        assert found.distance[0] >= 0.0
    inside = truth(scene(cloud(), light), light, found)
    np.testing.assert_allclose(found.at_point(found.march.transmittance), found.at_point(inside), atol=1e-3)


def test_a_scene_far_from_the_origin(renderer):
    there = np.array([1e5, -2e5, 3e5])
    description = scene(cloud(matrix=translation(*there)), point(np.add(there, (3.0, 2.0, 1.0))))
    near = scene(cloud(), point((3.0, 2.0, 1.0)))
    at = np.array([0.3, -0.2, 0.4])
    far, close = (
        probe(renderer, index_of(d), Settings(), "/Point", p) for d, p in ((description, there + at), (near, at))
    )
    np.testing.assert_allclose(far.march.transmittance, close.march.transmittance, atol=2e-3)


# --- the maps ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", LIGHTS)
def test_the_reconstructions_follow_the_curve(renderer, kind):
    found = probe(renderer, index_of(scene(cloud(size=48), LIGHTS[kind])), Settings(), "/Light", np.zeros(3))
    assert [c.name for c in found.curves] == ["quantile, 6 depths", "quantile, 14 depths", "56 slices"]
    assert error(found, "quantile, 6 depths") < 0.03
    assert error(found, "quantile, 14 depths") < 0.01
    assert error(found, "56 slices") < 0.01
    assert found.volume == "/Cloud"
    assert found.threshold == (THRESHOLD_INSIDE if kind == "point inside" else THRESHOLD)
    given = Settings(threshold=0.03)
    assert probe(renderer, index_of(scene(cloud(), LIGHTS[kind])), given, "/Light", np.zeros(3)).threshold == 0.03


@pytest.mark.parametrize("light", ["/World/Sun", "/World/Spot"])
def test_more_coefficients_are_nearer_on_the_plume(renderer, light):
    with previs.open(Path(__file__).parents[2] / "scenes" / "plume.usda") as stage:
        description = stage.describe()
    (smoke,) = description.volumes.values()
    lo, hi = volume_world_bounds(smoke)
    errors = []
    for height in (0.35, 0.5, 0.65):
        at = lo + (hi - lo) * [0.5, height, 0.5]
        found = probe(renderer, index_of(description), Settings(), light, at)
        assert found.march.transmittance.min() < 0.99
        errors.append([error(found, f"quantile, {n} depths") for n in (6, 14)])
    assert all(fine < coarse for coarse, fine in errors)
    coarse, fine = np.mean(errors, axis=0)
    assert fine < 0.6 * coarse
    assert coarse < 0.02


@pytest.mark.parametrize(
    ("values", "name"),
    [
        ({"transmittance": "tfm-plain"}, "tfm-plain, 6 coefficients"),
        ({"transmittance": "tfm"}, "tfm, 6 coefficients"),
        ({"transmittance": "quantile", "coefficients": 4}, "quantile, 4 depths"),
        ({"slices": 140}, "140 slices"),
        ({"transmittance": "tfm-plain", "coefficients": 14}, "tfm-plain, 14 coefficients"),
    ],
)
def test_the_current_settings_have_a_curve_of_their_own(renderer, values, name):
    description = scene(cloud(), LIGHTS["distant"])
    found = probe(renderer, index_of(description), Settings(**values), "/Light", np.zeros(3))
    assert [c.name for c in found.curves] == ["quantile, 6 depths", "quantile, 14 depths", name]
    assert error(found, name) < 0.06
    assert found.curves[-1].k_min < found.curves[-1].k_max


def test_the_range_of_a_dense_medium_ends_at_the_threshold(renderer):
    dense = Medium(extinction=(40.0, 40.0, 40.0))
    found = probe(renderer, index_of(scene(cloud(dense, 48), LIGHTS["spot"])), Settings(), "/Light", np.zeros(3))
    for made in found.curves[:2]:
        assert found.distance[0] < made.k_min < made.k_max < found.picked
        at_ends = np.interp([made.k_min, made.k_max], found.distance, found.march.transmittance[:, 0])
        # The march follows the ray itself, the map its nearest texel.
        np.testing.assert_allclose(at_ends, [1.0, found.threshold], atol=0.01)


def test_the_range_of_a_thin_medium_is_its_support(renderer):
    thin = Medium(extinction=(0.1, 0.1, 0.1))
    found = probe(renderer, index_of(scene(cloud(thin), LIGHTS["distant"])), Settings(), "/Light", np.zeros(3))
    made = found.curves[0]
    assert found.march.transmittance.min() > 0.5
    falling = found.distance[np.gradient(found.march.transmittance[:, 0]) < -1e-5]
    step = 2.0 / 24.0
    assert made.k_min == pytest.approx(falling[0], abs=2 * step)
    assert made.k_max == pytest.approx(falling[-1], abs=2 * step)


@pytest.mark.parametrize("kind", LIGHTS)
def test_more_slices_are_nearer(renderer, kind):
    index, errors = index_of(scene(cloud(Medium(extinction=(12.0, 12.0, 12.0)), 48), LIGHTS[kind])), []
    for slices in (28, 56, 112):
        found = probe(renderer, index, Settings(slices=slices, map_size=256), "/Light", np.zeros(3))
        made = curve(found, f"{slices} slices")
        assert -1e-5 <= made.k_min < found.picked < made.k_max
        errors.append(error(found, made.name))
    assert errors[0] > errors[1] > errors[2] and errors[2] < 0.005, errors


def test_a_method_without_values_says_none(renderer):
    found = probe(renderer, index_of(scene(cloud(), LIGHTS["spot"])), Settings(), "/Light", np.zeros(3))
    assert [(c.coefficients, c.slices) for c in found.curves] == [(6, 0), (14, 0), (0, 56)]
    march = Settings(transmittance="march")
    found = probe(renderer, index_of(scene(cloud(), LIGHTS["spot"])), march, "/Light", np.zeros(3))
    assert [c.name for c in found.curves] == ["quantile, 6 depths", "quantile, 14 depths"]


@pytest.mark.parametrize("kind", LIGHTS)
@pytest.mark.parametrize("method", ["slices", "quantile", "tfm", "tfm-plain"])
def test_only_the_texels_that_are_looked_at_are_filled(renderer, kind, method, monkeypatch):
    index, settings = index_of(scene(cloud(), LIGHTS[kind])), Settings(transmittance=method, coefficients=8)
    at = np.array([0.31, -0.27, 0.44])
    some = probe(renderer, index, settings, "/Light", at)
    monkeypatch.setattr(probe_module, "_texels", lambda *_: None)
    all_ = probe(renderer, index, settings, "/Light", at)
    for a, b in zip(some.curves, all_.curves, strict=True):
        np.testing.assert_array_equal(a.transmittance, b.transmittance)
        assert (a.k_min, a.k_max) == (b.k_min, b.k_max)


def test_rays_near_the_folds_of_an_octahedral_map(renderer, monkeypatch):
    """The edges of its square are folded: neighbours lie far apart."""
    index, lamp = index_of(scene(cloud(), LIGHTS["point inside"])), LIGHTS["point inside"].position
    for direction in ((0, 0, -1), (1e-4, 2e-4, -1), (1, 0, 0), (0.7, 0.7, -1e-4), (-0.5, 0.5, 0.001)):
        at = lamp + 0.4 * np.array(direction, float) / np.linalg.norm(direction)
        some = probe(renderer, index, Settings(), "/Light", at)
        with monkeypatch.context() as patch:
            patch.setattr(probe_module, "_texels", lambda *_: None)
            all_ = probe(renderer, index, Settings(), "/Light", at)
        np.testing.assert_array_equal(some.curves[0].transmittance, all_.curves[0].transmittance)


def test_the_maps_are_those_of_all_lights(renderer):
    """Many lights make every map coarser; the probe of one shows that."""
    lights = [point((3.0, 2.0, 0.1 * i), path=f"/L{i}") for i in range(40)]
    many, one = index_of(scene(cloud(), *lights)), index_of(scene(cloud(), lights[0]))
    sizes = [renderer.plan(i, camera((0, 0, 5)), 8, 8, Settings()).map_size for i in (many, one)]
    assert sizes[0] < sizes[1]
    at = np.array([0.3, -0.2, 0.4])
    curves = [probe(renderer, i, Settings(), "/L0", at).curves[0].transmittance for i in (many, one)]
    explicit = probe(renderer, one, Settings(map_size=sizes[0]), "/L0", at).curves[0].transmittance
    np.testing.assert_array_equal(curves[0], explicit)
    assert np.abs(curves[0] - curves[1]).max() > 1e-5


def test_a_random_neighbour_is_shown_by_its_mean(renderer):
    index = index_of(scene(cloud(), LIGHTS["distant"]))
    at = np.array([0.31, -0.27, 0.44])
    blend, random = (
        probe(renderer, index, Settings(map_filter=f), "/Light", at).curves[0].transmittance
        for f in ("blend", "stochastic")
    )
    np.testing.assert_array_equal(blend, random)


def test_homogeneous_media_need_no_map(renderer):
    description = scene(sphere(GREY), LIGHTS["point"])
    found = probe(renderer, index_of(description), Settings(), "/Light", np.zeros(3))
    expected = truth(description, LIGHTS["point"], found)
    for made in (found.march, *found.curves):
        np.testing.assert_allclose(made.transmittance, expected, atol=1e-5)
        assert np.isnan(made.k_min) and np.isnan(made.k_max)
    assert found.volume == ""


def test_nothing_on_the_way(renderer):
    for description in (scene(LIGHTS["spot"]), scene(cloud(), LIGHTS["spot"])):
        found = probe(renderer, index_of(description), Settings(), "/Light", np.array([0.0, 4.5, 1.0]))
        for made in (found.march, *found.curves):
            np.testing.assert_array_equal(made.transmittance, 1.0)
            assert np.isnan(made.k_min)


def test_the_volume_is_the_one_the_point_is_in_or_nearest_to(renderer):
    index = index_of(
        scene(
            cloud(path="/Near", matrix=translation(-3, 0, 0)),
            cloud(path="/Far", matrix=translation(3, 0, 0)),
            cloud(path="/Within", matrix=scaling(0.3, 0.3, 0.3) @ translation(-3, 0, 0)),
            distant((1.0, 0.0, 0.0)),
        )
    )
    places = {"/Near": (-3.8, 0, 0), "/Far": (3.0, 0, 0), "/Within": (-3.0, 0, 0)}
    for path, at in places.items():
        assert probe(renderer, index, Settings(), "/Sun", np.array(at)).volume == path
    between = probe(renderer, index, Settings(), "/Sun", np.array([1.0, 0.0, 0.0]))
    assert between.volume == "/Far"
    assert between.curves[0].k_min > between.picked


# --- meshes and lights ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", ["distant", "point", "spot"])
def test_shadows_of_meshes_are_told_apart(renderer, kind):
    light = LIGHTS[kind]
    origin = -5.0 * light.direction if kind == "distant" else light.position
    direction = -origin / np.linalg.norm(origin)
    lid = box_mesh((-0.5, -0.5, -0.5), (0.5, 0.5, 0.5), matrix=translation(*(-1.6 * direction)))
    index = index_of(scene(cloud(), light, lid))
    found = probe(renderer, index, Settings(), "/Light", np.zeros(3))
    open_ = probe(renderer, index_of(scene(cloud(), light)), Settings(), "/Light", np.zeros(3))
    assert found.at_point(found.visibility) == 0.0
    np.testing.assert_array_equal(open_.visibility, 1.0)
    at = found.origin + found.distance[:, None] * found.direction
    before = (at @ direction) < -2.5
    assert (found.visibility[before] == 1.0).all()
    same = np.interp(open_.picked, open_.distance, open_.march.transmittance[:, 0])
    assert found.at_point(found.march.transmittance)[0] == pytest.approx(same, abs=2e-3)


def test_a_light_without_shadows_and_one_without_power(renderer):
    at = np.array([0.3, -0.2, 0.4])
    free = probe(renderer, index_of(scene(cloud(), point((3, 2, 1), casts_shadows=False))), Settings(), "/Point", at)
    np.testing.assert_array_equal(free.march.transmittance, 1.0)
    np.testing.assert_array_equal(free.curves[0].transmittance, 1.0)
    dark, lit = (
        probe(renderer, index_of(scene(cloud(), point((3, 2, 1), strength))), Settings(), "/Point", at)
        for strength in ((0.0, 0.0, 0.0), (1.0, 1.0, 1.0))
    )
    np.testing.assert_array_equal(dark.curves[0].transmittance, lit.curves[0].transmittance)


def test_a_point_at_the_light_itself(renderer):
    light = LIGHTS["point inside"]
    found = probe(renderer, index_of(scene(cloud(), light)), Settings(), "/Light", light.position)
    for made in (found.march, *found.curves):
        assert np.isfinite(made.transmittance).all()
    np.testing.assert_allclose(found.at_point(found.march.transmittance), 1.0, atol=0.02)


def test_lights_that_have_no_ray(renderer):
    dome = Light("/Dome", "dome", np.eye(4), (1.0, 1.0, 1.0), (1.0, 1.0, 1.0))
    index = index_of(scene(cloud(), dome))
    with pytest.raises(previs.PrevisError, match="/Dome: a dome lights every point evenly"):
        probe(renderer, index, Settings(), "/Dome", np.zeros(3))
    with pytest.raises(previs.PrevisError, match="/Nowhere: no such light"):
        probe(renderer, index, Settings(), "/Nowhere", np.zeros(3))
    with pytest.raises(previs.PrevisError, match=r"/Light: no ray goes through \[ 0. nan  0.\]"):
        probe(renderer, index_of(scene(LIGHTS["spot"])), Settings(), "/Light", np.array([0.0, np.nan, 0.0]))


# --- the renderer -----------------------------------------------------------------------------------------------------


def test_the_renderer_keeps_what_it_has_drawn(renderer):
    description = scene(cloud(), LIGHTS["distant"], distant((0, -1, 0)), box_mesh((-2, -2, -2), (2, -1.5, 2)))
    index, view = index_of(description), camera((0, 0, 6))
    before = renderer.render(index, view, (32, 18), Settings())
    for _ in range(2):
        probe(renderer, index, Settings(), "/Light", np.zeros(3))
    again = renderer.render(index, view, (32, 18), Settings())
    assert renderer.executed == []
    np.testing.assert_array_equal(again.color, before.color)


def test_a_drawing_goes_on_after_a_probe(renderer):
    description = scene(cloud(), LIGHTS["distant"])
    index, view = index_of(description), camera((0, 0, 6))
    whole = renderer.render(index, view, (64, 36), Settings())
    fresh = index_of(description)
    plan = renderer.plan(fresh, view, 64, 36, Settings())
    for fraction in renderer.drawing(plan, 1e-4):
        if fraction < 1.0:
            probe(renderer, fresh, Settings(), "/Light", np.zeros(3))
    np.testing.assert_array_equal(renderer.image(plan).color, whole.color)


def test_the_bound_framebuffer_stays(renderer):
    index = index_of(scene(cloud(), LIGHTS["distant"]))
    with renderer.context as context:
        mine = context.simple_framebuffer((7, 5))
        mine.use()
    probe(renderer, index, Settings(), "/Light", np.zeros(3))
    with renderer.context as context:
        assert context.detect_framebuffer().glo == mine.glo
        assert context.error == "GL_NO_ERROR"
        renderer._frame.rest()
        mine.release()
