"""What a march of few steps owes to how it steps: edges are searched for, deep steps cut, cells integrated exactly."""

import numpy as np
import pytest
from building import box, distant, index_of, point, scene, sphere, spot, volume
from cases import FRONT, GRID, ROTATED, SIDE, TURNED, fog

import previs
from previs import Settings, metrics
from previs.bench.reference_scene import reference_image
from previs.description import SceneDescription, Shaping
from previs.render import draws

pytestmark = pytest.mark.gl

SIZE = (32, 18)
LAMP = point((1.5, 1.2, 1.8), (6.0, 5.0, 4.0))


def render(renderer: previs.Renderer, description: SceneDescription, **knobs) -> previs.Image:
    return renderer.render(index_of(description), FRONT, SIZE, Settings(**{"transmittance": "march", **knobs}))


def hard_spot(degrees: float) -> SceneDescription:
    light = spot((0.3, 2.5, 0.5), (0.0, 0.0, 0.0), (20.0, 20.0, 20.0), Shaping(degrees))
    return scene(box(fog(0.5)), light)


@pytest.mark.parametrize(("degrees", "limit"), [(5.0, 3e-3), (20.0, 1e-3), (40.0, 1e-4)])
def test_hard_edges_of_a_cone(renderer: previs.Renderer, record_property, degrees: float, limit: float) -> None:
    """At 64 steps no band of a step's width shows at the edge of a beam, however narrow."""
    description = hard_spot(degrees)
    truth = reference_image(description, FRONT, *SIZE)
    error = metrics.mean_relative_error(render(renderer, description, steps=64).color, truth.color)
    record_property("mean_relative_error", error)
    assert error <= limit


@pytest.mark.parametrize("light", [SIDE, LAMP], ids=["sun", "lamp"])
@pytest.mark.parametrize("depth", [30.0, 1000.0, 30_000.0])
def test_deep_steps_are_cut(renderer: previs.Renderer, record_property, monkeypatch, depth: float, light) -> None:
    """A box of that optical depth at 64 steps: the front is resolved; left whole its steps are much too dark."""
    description = scene(box(fog(0.5 * depth), local_to_world=TURNED), light)
    truth = reference_image(description, FRONT, *SIZE)
    error = metrics.mean_relative_error(render(renderer, description, steps=64).color, truth.color)
    monkeypatch.setattr(draws, "MOST_CUTS", 0)
    whole = metrics.mean_relative_error(render(renderer, description, steps=64).color, truth.color)
    record_property("cut", error)
    record_property("whole", whole)
    assert error <= 0.003
    assert whole > 10.0 * error


@pytest.mark.parametrize(("depth", "limit"), [(10.0, 2e-4), (1000.0, 3e-3)])
def test_deep_voxels_are_cut(renderer: previs.Renderer, record_property, depth: float, limit: float) -> None:
    """The same of voxels, whose density rises."""
    description = scene(volume(GRID, fog(0.5 * depth), ROTATED), SIDE)
    truth = reference_image(description, FRONT, *SIZE, max_error=1e-3)
    error = metrics.mean_relative_error(render(renderer, description, steps=64).color, truth.color)
    record_property("mean_relative_error", error)
    assert error <= limit


LIGHTS = {
    "sun": SIDE,
    "lamp": LAMP,
    "lamp inside": point((0.1, 0.0, 0.1), (1.0, 1.0, 1.0), radius=0.1),
    "along the cells": distant((1.0, 0.0, 0.0), (3.0, 3.0, 3.0)),
}


@pytest.mark.parametrize("extinction", [(3.0, 3.0, 3.0), (0.3, 3.0, 20.0)], ids=["grey", "coloured"])
@pytest.mark.parametrize("light", LIGHTS)
def test_a_march_from_cell_to_cell_is_exact(renderer: previs.Renderer, record_property, light: str, extinction) -> None:
    """`light_steps=0` gives the light that thousands of steps converge to."""
    matrix = None if light == "along the cells" else ROTATED
    description = scene(volume(GRID, fog(extinction), matrix), LIGHTS[light])
    exact, few, many = (render(renderer, description, steps=512, light_steps=n).color for n in (0, 32, 4096))
    error, coarse = metrics.mean_relative_error(exact, many), metrics.mean_relative_error(few, many)
    record_property("exact", error)
    record_property("32 steps", coarse)
    assert error <= 1e-5
    assert coarse > 10.0 * error


def test_a_march_from_cell_to_cell_through_a_lattice(renderer: previs.Renderer) -> None:
    """Every other voxel empty, so that no step of any length fits."""
    lattice = np.indices((12, 12, 12)).sum(axis=0) % 2 * 1.0
    description = scene(volume(lattice, fog(8.0), TURNED), SIDE)
    exact, many = (render(renderer, description, steps=512, light_steps=n).color for n in (0, 4096))
    assert metrics.mean_relative_error(exact, many) <= 1e-4


def test_deep_steps_are_cut_beside_long_light_marches(renderer: previs.Renderer) -> None:
    """How a view ray is cut does not depend on the steps towards a light; where they leave no room, a note says."""
    description = scene(volume(GRID, fog(50.0), ROTATED), SIDE)
    exact, many, most = (render(renderer, description, steps=32, light_steps=n) for n in (0, 1024, 8192))
    assert metrics.mean_relative_error(many.color, exact.color) <= 1e-4
    assert not [n for n in many.stats["notes"] if "cut finer" in n]
    assert [n for n in most.stats["notes"] if "cut finer" in n]


@pytest.mark.parametrize("steps", [16, 1024, 16384])
@pytest.mark.parametrize("depth", [1e-6, 1e-3, 0.1])
def test_transmittance_does_not_drift(renderer: previs.Renderer, record_property, depth: float, steps: int) -> None:
    """However many steps a thin medium is marched in, what is lost of the background is its optical depth."""
    description = scene(sphere(fog(0.5 * depth)), SIDE)
    truth = reference_image(description, FRONT, *SIZE)
    image = render(renderer, description, steps=steps)
    error = float(np.abs(image.alpha - truth.alpha).max())
    record_property("alpha", error)
    record_property("color", metrics.mean_relative_error(image.color, truth.color))
    # A transmittance next to 1 is rounded to 6e-8, in every draw that takes up another.
    assert error <= 6e-7 + 1e-4 * depth
    assert metrics.mean_relative_error(image.color, truth.color) <= 5e-4
