"""A plan holds what the scene needs and nothing else; it is made without OpenGL."""

from dataclasses import replace

import numpy as np
import pytest
from building import (
    box,
    box_mesh,
    camera,
    distant,
    index_of,
    point,
    scene,
    smooth_noise,
    sphere,
    spot,
    translation,
    volume,
)

from previs import Medium, PrevisError, Settings
from previs.description import SceneDescription, Shaping
from previs.index import RenderIndex
from previs.render.method import METHODS
from previs.render.plan import make_plan
from previs.render.planned import Plan
from previs.settings import BY_NAME

NOISE = smooth_noise((8, 8, 8))
VIEW = camera((0.0, 0.0, 6.0))


def plan(description: SceneDescription, **settings) -> Plan:
    return make_plan(index_of(description), VIEW, 64, 36, Settings(**settings))


def kinds(description: SceneDescription, **settings) -> list[str]:
    return [p.kind for p in plan(description, **settings).passes]


def test_nothing() -> None:
    assert kinds(scene()) == ["composite"]


def test_lights_alone() -> None:
    assert kinds(scene(distant((0, -1, 0)), point((0, 2, 0)))) == ["composite"]


def test_no_volume_no_maps() -> None:
    """Meshes and lights: shadow maps and surfaces, nothing of media."""
    passes = kinds(scene(box_mesh((-1, -1, -1), (1, 1, 1)), distant((0, -1, 0)), point((0, 2, 0))))
    assert passes == ["shadow_map", "shadow_map", "gbuffer", "surface", "composite"]


def test_no_mesh_no_shadow_map() -> None:
    passes = kinds(scene(volume(NOISE, Medium()), distant((0, -1, 0))))
    assert passes == ["fields", "transmittance_map", "march", "composite"]


def test_homogeneous_media_need_no_voxels_and_no_maps() -> None:
    passes = kinds(scene(box(Medium()), sphere(Medium()), distant((0, -1, 0))))
    assert passes == ["march", "composite"]


def test_no_light_no_maps() -> None:
    """A volume that only hides, or glows."""
    assert kinds(scene(volume(NOISE, Medium(emission=(1, 1, 1))))) == ["fields", "march", "composite"]


@pytest.mark.parametrize("name", [n for n in BY_NAME["transmittance"].choices if n != "march"])
def test_every_method_of_maps_fills_them(name: str) -> None:
    """And its plan says with what."""
    made = plan(scene(volume(NOISE, Medium()), distant((0, -1, 0))), transmittance=name)
    assert [p.kind for p in made.passes] == ["fields", "transmittance_map", "march", "composite"]
    (march,) = (p for p in made.passes if p.kind == "march")
    assert METHODS[name].why(6) in march.why


def test_brute_force_needs_no_maps() -> None:
    description = scene(volume(NOISE, Medium()), distant((0, -1, 0)))
    assert kinds(description, transmittance="march") == ["fields", "march", "composite"]


def test_a_map_for_every_pair() -> None:
    """Two lights and two volumes of voxels, and a shape that needs none."""
    description = scene(
        volume(NOISE, Medium(), path="/A"),
        volume(NOISE, Medium(), path="/B"),
        box(Medium()),
        distant((0, -1, 0)),
        point((0, 3, 0)),
    )
    names = [p.name for p in plan(description).passes if p.kind == "transmittance_map"]
    assert sorted(names) == sorted(
        f"transmittance_map {light} > {v}" for light in ("/Sun", "/Point") for v in "/A /B".split()
    )


def test_a_light_without_shadows_needs_no_maps() -> None:
    description = scene(
        volume(NOISE, Medium()), box_mesh((-1, -1, -1), (1, 1, 1)), distant((0, -1, 0), casts_shadows=False)
    )
    assert kinds(description) == ["fields", "gbuffer", "surface", "march", "composite"]


def test_what_cannot_be_seen_is_not_planned() -> None:
    """A medium without extinction, and a light without strength."""
    dark = distant((0, -1, 0), (0.0, 0.0, 0.0))
    assert kinds(scene(box(Medium(extinction=(0, 0, 0))), dark)) == ["composite"]
    assert plan(scene(box(Medium()), dark)).lights == ()
    assert plan(scene(box(Medium(density_scale=0.0)))).volumes == ()


@pytest.mark.parametrize(
    ("define", "without", "added"),
    [
        ("HAS_POINT", [distant((0, -1, 0))], point((0, 2, 0))),
        ("HAS_SHAPING", [point((0, 2, 0))], spot((0, 2, 0), (0, 0, 0))),
        ("HAS_COSINE", [point((0, 2, 0))], spot((0, 2, 0), (0, 0, 0), kind="rect", shaped=False)),
        ("HAS_MESHES", [distant((0, -1, 0))], box_mesh((-1, -1, -1), (1, 1, 1))),
        ("HAS_SHADOW_MAPS", [distant((0, -1, 0))], box_mesh((-1, -1, -1), (1, 1, 1))),
        ("HAS_GRIDS", [], volume(NOISE, Medium())),
        ("HAS_EMISSION", [], sphere(Medium(emission=(1, 0, 0)))),
        ("HAS_EMISSION_FIELD", [], volume(NOISE, Medium(emission=(1, 0, 0)), emission=NOISE)),
        ("HAS_TEMPERATURE", [], volume(NOISE, Medium(emission=(1, 0, 0)), temperature=NOISE)),
        ("CHROMATIC", [], sphere(Medium(extinction=(1, 2, 3)))),
        ("HAS_SPECULAR", [], box_mesh((-1, -1, -1), (1, 1, 1), specular=True)),
        ("HAS_EMISSIVE", [], box_mesh((-1, -1, -1), (1, 1, 1), emissive_color=(0, 0, 1))),
    ],
)
def test_code_is_compiled_only_where_it_is_needed(define: str, without, added) -> None:
    base = [box(Medium()), *without]
    assert not plan(scene(*base)).defines[define]
    assert plan(scene(*base, added)).defines[define]


def test_emission_that_cannot_show_is_not_planned() -> None:
    """Nothing is emitted where nothing is absorbed."""
    assert not plan(scene(sphere(Medium(albedo=(1, 1, 1), emission=(1, 1, 1))))).defines["HAS_EMISSION"]


def test_one_phase_function_is_compiled_in() -> None:
    """Several media of one phase share it; of different ones, the shader looks it up."""
    schlick = Medium(phase="schlick", anisotropy=0.5)
    assert plan(scene(box(schlick), sphere(schlick))).defines["PHASE"] == 2
    assert plan(scene(box(schlick), sphere(Medium(phase="rayleigh")))).defines["PHASE"] == -1
    assert plan(scene(box(Medium(phase="hg", anisotropy=0.0)))).defines["PHASE"] == 0


def test_projective_steps_are_for_one_spot_in_homogeneous_fog() -> None:
    fog, mesh = box(Medium()), box_mesh((-0.1, 1, -0.1), (0.1, 1.1, 0.1))
    narrow = spot((0, 2, 0), (0, 0, 0))
    assert plan(scene(fog, mesh, narrow)).defines["PROJECTIVE_STEPS"]
    assert not plan(scene(fog, mesh, narrow), projective_steps=False).defines["PROJECTIVE_STEPS"]
    assert not plan(scene(fog, narrow)).defines["PROJECTIVE_STEPS"]
    assert not plan(scene(fog, mesh, narrow, distant((0, -1, 0)))).defines["PROJECTIVE_STEPS"]
    assert not plan(scene(fog, mesh, narrow, volume(NOISE, Medium()))).defines["PROJECTIVE_STEPS"]
    wide = spot((0, 2, 0), (0, 0, 0), shaping=Shaping(cone_angle=80.0))
    assert not plan(scene(fog, mesh, wide)).defines["PROJECTIVE_STEPS"]


@pytest.mark.parametrize(
    ("light", "kind"),
    [
        (distant((0, -1, 0)), "orthographic"),
        (point((0, 5, 0)), "perspective"),
        (point((0.2, 0, 0)), "octahedral"),
        (point((0, 1.05, 0)), "octahedral"),
        (spot((0, 0, 0), (0, -1, 0)), "perspective"),
        (spot((0, 0, 0), (0, -1, 0), shaping=Shaping(cone_angle=80.0)), "octahedral"),
    ],
)
def test_kinds_of_maps(light, kind: str) -> None:
    """Fitted to where the light stands: parallel, before it, inside it, or along a narrow cone."""
    (planned,) = plan(scene(volume(NOISE, Medium()), light)).maps
    assert planned.fit.kind == kind


def test_every_pass_says_why_and_what_it_takes() -> None:
    """The text of the plan has a line per pass and the sum of their memory."""
    made = plan(scene(volume(NOISE, Medium()), box_mesh((-1, -1, -1), (1, 1, 1)), distant((0, -1, 0))))
    lines = made.describe().splitlines()
    assert len(lines) == len(made.passes) + 1
    for line, planned in zip(lines, made.passes, strict=False):
        assert line.startswith(planned.name)
        assert planned.why
        assert planned.why in line
        assert planned.memory > 0
    assert lines[-1].startswith("total")


def test_inputs_are_passes_before() -> None:
    """A pass reads only what an earlier one wrote."""
    made = plan(
        scene(volume(NOISE, Medium()), box_mesh((-1, -1, -1), (1, 1, 1)), distant((0, -1, 0)), point((0, 2, 0)))
    )
    seen: set[str] = set()
    for planned in made.passes:
        assert set(planned.inputs) <= seen, planned.name
        assert planned.name not in seen
        seen.add(planned.name)


def test_batches_and_slices_cover_everything_once() -> None:
    """All lights in order, and all steps in order, whatever the number of volumes."""
    for lights, settings in (
        (0, {}),
        (1, {}),
        (200, {}),
        (3, {"transmittance": "march", "steps": 4096, "light_steps": 4096}),
    ):
        sources = [point((0, 3 + i, 0), path=f"/P{i}") for i in range(lights)]
        made = plan(scene(volume(NOISE, Medium()), *sources), **settings)
        assert [i for batch in made.batches for i in batch] == list(range(lights))
        assert [i for part in made.slices for i in part] == list(range(made.slices[-1].stop))
        assert made.slices[-1].stop > made.settings.steps


def test_too_many_volumes_are_refused() -> None:
    """In one line that names a volume and what to do."""
    balls = [sphere(Medium(), path=f"/Ball{i}") for i in range(129)]
    with pytest.raises(PrevisError, match=r"^/Ball128: .*129 volumes"):
        plan(scene(*balls))


def test_a_field_too_large_is_reduced_and_said_so() -> None:
    """The memory of the plan follows, and the note names the volume."""
    made = plan(scene(volume(np.ones((100, 100, 100)), Medium())), field_memory=1)
    assert any(n.path == "/Volume" and "2³" in n.message for n in made.notes)
    assert made.passes[0].memory < 1.5 * 2**20


def test_an_edit_fits_what_it_moves_anew() -> None:
    """Fits are kept from plan to plan of one index; they are those of a plan made from nothing."""
    index = RenderIndex()
    cloud, solid = volume(NOISE, Medium()), box_mesh((-1, -3, -1), (1, -2, 1))
    sun, lamp = distant((0.2, -1, 0)), point((0, 3, 0))
    aside = translation(0.5, 0.25, 0.0)
    steps = [
        scene(cloud, solid, sun, lamp),
        scene(replace(cloud, local_to_world=aside), solid, sun, lamp),
        scene(cloud, replace(solid, local_to_world=aside[None]), sun, lamp),
        scene(cloud, solid, replace(sun, light_to_world=distant((1, -1, 0)).light_to_world), lamp),
        scene(volume(NOISE[2:], Medium()), solid, sun, replace(lamp, light_to_world=translation(0, 4, 0))),
        scene(cloud, solid, sun, lamp),
    ]
    for description in steps:
        index.update(description)
        kept = make_plan(index, VIEW, 64, 36, Settings())
        fresh = make_plan(index_of(description), VIEW, 64, 36, Settings())
        assert [m.fit.key() for m in kept.maps] == [m.fit.key() for m in fresh.maps]
        assert [x.shadow.key() for x in kept.lights] == [x.shadow.key() for x in fresh.lights]
        assert kept.map_size == fresh.map_size
