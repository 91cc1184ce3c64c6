"""An edit runs the passes that depend on it and no others."""

from dataclasses import replace

import numpy as np
import pytest
from building import box_mesh, camera, distant, index_of, point, scene, smooth_noise, translation, volume

import previs
from previs import Medium, Settings
from previs.description import SceneDescription, Surface

pytestmark = pytest.mark.gl

NOISE = smooth_noise((8, 8, 8))
VIEW = camera((0.5, 1.0, 6.0))
SETTINGS = Settings(steps=16, light_steps=16, shadow_map_size=64, map_size=16)
SUN_MAPS = {"transmittance_map /Sun > /A", "transmittance_map /Sun > /B"}
POINT_MAPS = {"transmittance_map /Point > /A", "transmittance_map /Point > /B"}
SHADOWS = {"shadow_map /Sun", "shadow_map /Point"}
LIT = {"surface", "march", "composite"}
ALL = {"fields", "gbuffer"} | SHADOWS | SUN_MAPS | POINT_MAPS | LIT


def start() -> SceneDescription:
    return scene(
        volume(NOISE, Medium(), translation(-1.1, 0, 0), "/A"),
        volume(NOISE, Medium(), translation(1.1, 0, 0), "/B"),
        box_mesh((-0.5, -2.0, -0.5), (0.5, -1.5, 0.5), path="/Mesh"),
        distant((0.1, -1.0, 0.2)),
        point((0.0, 3.0, 1.0), (3.0, 3.0, 3.0)),
    )


def edited(kind: str, path: str, **values) -> SceneDescription:
    description = start()
    records = getattr(description, kind)
    records[path] = replace(records[path], **values)
    return description


class Session:
    """A renderer that follows one scene."""

    def __init__(self, renderer: previs.Renderer) -> None:
        self.renderer = renderer
        self.index = index_of(start())
        self.ran()

    def ran(self, description: SceneDescription | None = None, view=VIEW, size=(16, 9), settings=SETTINGS) -> set[str]:
        """What one more frame ran; every pass at most once, and its picture is that of a fresh start."""
        if description is not None:
            self.index.update(description)
        image = self.renderer.render(self.index, view, size, settings)
        executed = list(self.renderer.executed)
        assert len(executed) == len(set(executed))
        assert list(image.stats["executed"]) == executed
        assert set(image.stats["times"]) == set(executed)
        fresh = self.renderer.render(index_of(self.index.scene), view, size, settings)
        # A map that was kept was made where its voxels lay in the atlas then: the last digit may differ.
        np.testing.assert_allclose(image.color, fresh.color, rtol=1e-5, atol=1e-7)
        # The fresh start took the renderer's memory with it: fill it again.
        self.renderer.render(self.index, view, size, settings)
        return set(executed)


@pytest.fixture
def session(renderer: previs.Renderer) -> Session:
    return Session(renderer)


def test_first_frame_runs_everything(renderer: previs.Renderer) -> None:
    """In an order in which no pass comes before what it reads."""
    index = index_of(start())
    renderer.render(index, VIEW, (16, 9), SETTINGS)
    assert set(renderer.executed) == ALL
    plan = renderer.plan(index, VIEW, 16, 9, SETTINGS)
    assert renderer.executed == [p.name for p in plan.passes]


def test_no_change_runs_nothing(session: Session) -> None:
    assert session.ran() == set()


def test_an_equal_description_runs_nothing(session: Session) -> None:
    """Records made anew with the same content are the same scene."""
    assert session.ran(start()) == set()


@pytest.mark.parametrize(
    "values",
    [{"albedo": (0.5, 0.6, 0.7)}, {"anisotropy": 0.4}, {"phase": "rayleigh"}, {"emission": (1.0, 0.5, 0.0)}],
)
def test_scattering_edit(session: Session, values) -> None:
    """Albedo, phase and emission are only marched through; the lit meshes stay."""
    assert session.ran(edited("volumes", "/A", medium=Medium(**values))) == {"march", "composite"}


@pytest.mark.parametrize("values", [{"extinction": (2.0, 2.0, 2.0)}, {"density_scale": 0.5}])
def test_extinction_edit(session: Session, values) -> None:
    """The maps of that volume, and whatever its shadow falls on."""
    expected = {"transmittance_map /Sun > /A", "transmittance_map /Point > /A"} | LIT
    assert session.ran(edited("volumes", "/A", medium=Medium(**values))) == expected


def test_light_colour_edit(session: Session) -> None:
    """No map knows a colour."""
    assert session.ran(edited("lights", "/Sun", strength=(2.0, 1.0, 0.5))) == LIT


def test_light_move(session: Session) -> None:
    """Its own shadow map and transmittance maps, not the other light's."""
    moved = start().lights["/Point"].light_to_world @ translation(0.5, 0.2, 0.1)
    expected = {"shadow_map /Point"} | POINT_MAPS | LIT
    assert session.ran(edited("lights", "/Point", light_to_world=moved)) == expected


def test_mesh_move(session: Session) -> None:
    """Shadow maps of all lights and the G-buffer; transmittance maps hold no meshes."""
    moved = translation(0.1, 0.0, 0.2)[None]
    assert session.ran(edited("meshes", "/Mesh", local_to_world=moved)) == SHADOWS | {"gbuffer"} | LIT


def test_surface_edit(session: Session) -> None:
    """A colour of a mesh: what is seen of it, not the shadow it casts, and not the media."""
    assert session.ran(edited("meshes", "/Mesh", surface=Surface((0.9, 0.1, 0.1)))) >= {
        "gbuffer",
        "surface",
        "composite",
    }
    assert not session.ran(edited("meshes", "/Mesh", surface=Surface((0.1, 0.9, 0.1)))) & (
        SHADOWS | SUN_MAPS | POINT_MAPS
    )


def test_volume_move(session: Session) -> None:
    """Its maps of both lights; shadow maps are fitted to the media too and may follow."""
    ran = session.ran(edited("volumes", "/A", local_to_world=translation(-1.2, 0.1, 0.0)))
    assert {"transmittance_map /Sun > /A", "transmittance_map /Point > /A"} | LIT <= ran
    assert not ran & {"transmittance_map /Sun > /B", "transmittance_map /Point > /B"}


def test_voxel_edit(session: Session) -> None:
    """New voxels are uploaded, and only the maps of their volume made again."""
    other = volume(NOISE[::-1], Medium()).density
    ran = session.ran(edited("volumes", "/A", density=other))
    assert {"fields", "transmittance_map /Sun > /A", "transmittance_map /Point > /A"} | LIT <= ran
    assert not ran & SHADOWS


def test_camera_move(session: Session) -> None:
    assert session.ran(view=camera((0.7, 1.0, 6.0))) == {"gbuffer"} | LIT


def test_image_size(session: Session) -> None:
    assert session.ran(size=(20, 10)) == {"gbuffer"} | LIT


@pytest.mark.parametrize(
    ("values", "expected"),
    [
        ({"steps": 24}, {"march", "composite"}),
        ({"opacity_cutoff": 1e-3}, {"march", "composite"}),
        ({"ambient": 0.2}, LIT),
        ({"map_filter": "nearest"}, LIT),
        ({"map_filter": "stochastic"}, LIT),
        ({"density_weighting": 3.0}, SUN_MAPS | POINT_MAPS | LIT),
        ({"light_steps": 24}, SUN_MAPS | POINT_MAPS | LIT),
        ({"threshold": 0.05}, SUN_MAPS | POINT_MAPS | LIT),
        ({"map_size": 24}, SUN_MAPS | POINT_MAPS | LIT),
        ({"coefficients": 8}, SUN_MAPS | POINT_MAPS | LIT),
        ({"shadow_map_size": 32}, SHADOWS | LIT),
        ({"transmittance": "march"}, LIT),
        ({"transmittance": "tfm"}, SUN_MAPS | POINT_MAPS | LIT),
        ({"transmittance": "tfm-plain"}, SUN_MAPS | POINT_MAPS | LIT),
        ({"error_pixels": 64}, set()),
    ],
)
def test_settings(session: Session, values, expected: set[str]) -> None:
    """A knob runs what it says in the table of settings that it invalidates, and what depends on that."""
    assert session.ran(settings=SETTINGS.replace(**values)) == expected


THIRD_MAPS = {"shadow_map /Third", "transmittance_map /Third > /A", "transmittance_map /Third > /B"}


def with_third(first: bool = False) -> SceneDescription:
    """The scene and one more light, before or behind the others."""
    description = start()
    third = {"/Third": point((2.0, 3.0, 1.0), path="/Third")}
    lights = {**third, **description.lights} if first else {**description.lights, **third}
    return replace(description, lights=lights)


def without(description: SceneDescription, *paths: str) -> SceneDescription:
    return replace(description, lights={p: x for p, x in description.lights.items() if p not in paths})


@pytest.mark.parametrize("first", [False, True])
def test_a_light_more_and_a_light_less(session: Session, first: bool) -> None:
    """All maps of the lights that stay keep their place, though the atlases grow."""
    assert session.ran(with_third(first)) == THIRD_MAPS | LIT
    assert session.ran(start()) == LIT


@pytest.mark.parametrize("path", ["/Sun", "/Point"])
def test_a_light_that_is_hidden_and_shown_again(session: Session, path: str) -> None:
    """No map is made again, its own neither."""
    assert session.ran(without(start(), path)) == LIT
    assert session.ran(start()) == LIT


@pytest.mark.parametrize("path", ["/Sun", "/Point"])
def test_a_light_that_is_dimmed_to_nothing(session: Session, path: str) -> None:
    dark = edited("lights", path, strength=(0.0, 0.0, 0.0))
    assert session.ran(dark) == LIT
    assert session.ran(edited("lights", path, strength=(1.0, 2.0, 3.0))) == LIT


def test_one_light_after_the_other_alone(session: Session) -> None:
    """Every map is made once."""
    assert session.ran(with_third()) == THIRD_MAPS | LIT
    lights = ("/Sun", "/Point", "/Third")
    for shown in (*lights, *lights):
        assert session.ran(without(with_third(), *(p for p in lights if p != shown))) == LIT
    assert session.ran(without(start(), "/Sun", "/Point")) == LIT
    assert session.ran(with_third()) == LIT


def test_a_light_moved_while_it_was_hidden(session: Session) -> None:
    """It is not taken for what it was."""
    assert session.ran(without(start(), "/Point")) == LIT
    moved = start().lights["/Point"].light_to_world @ translation(0.5, 0.2, 0.1)
    assert session.ran(edited("lights", "/Point", light_to_world=moved)) == {"shadow_map /Point"} | POINT_MAPS | LIT


def test_a_hidden_light_gives_way(session: Session) -> None:
    """Many others may have its tiles, and then it gets new ones."""
    session.ran(without(start(), "/Point"))
    others = without(start(), "/Point")
    for number in range(5):
        path = f"/Other{number}"
        others = replace(others, lights={**others.lights, path: point((number, 3.0, 0.5), path=path)})
        assert {f"shadow_map {path}", f"transmittance_map {path} > /A"} <= session.ran(others)
    assert session.ran(start()) <= {"shadow_map /Point"} | POINT_MAPS | LIT


def test_a_failed_frame_runs_again(session: Session) -> None:
    """A frame that its progress callback stops leaves nothing half done."""

    class Stop(Exception):
        pass

    def stop(_: float) -> None:
        raise Stop

    settings = SETTINGS.replace(transmittance="march", steps=512, light_steps=512)
    with pytest.raises(Stop):
        session.renderer.render(session.index, VIEW, (16, 9), settings, progress=stop)
    assert {"march", "composite"} <= session.ran(settings=settings)
