"""Hard cases of the medium itself: its depth, colour, phase function and the magnitude of its voxels."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ... import reference
from ...description import PHASES, Volume
from ..reference_scene import reference_camera, reference_scene
from .records import CLOUD, COLUMN, FRONT, SIDE, TURNED, cloud, distant, fog, scene, smooth_noise, sphere, volume
from .trial import ANY, SIZE, Trial, case

#: Settings of pictures that are only compared with one another.
COARSE = {"steps": 96, "light_steps": 96, "map_size": 64}


@case("zero density")
def zero_density(trial: Trial) -> None:
    """A medium without extinction is not there; a hole of zeros in a cloud is a hole."""
    for nothing in (sphere(fog(0.0)), cloud(0.0)):
        image = trial.render(scene(nothing, SIDE))
        trial.measure(max(image.color.max(), image.alpha.max()), 0.0, "light from nothing")
    hollow = CLOUD.copy()
    hollow[3:10, 4:12, 3:9] = 0.0
    trial.right(scene(volume(hollow, fog(3.0), TURNED), SIDE))


@case("optical depth from 1e-6 to 1e6", methods=(ANY,))
def shape_thin_to_solid(trial: Trial) -> None:
    """A homogeneous sphere, from one that nothing stops in to one that is solid, against the reference."""
    for exponent in range(-6, 7, 2):
        trial.right(scene(sphere(fog(0.5 * 10.0**exponent)), SIDE), noted="32 bits", opacity_cutoff=0.0)


@case("optical depth from 1e-6 to 1e6", coefficients=(6,))
def voxels_thin(trial: Trial) -> None:
    """Depths from 1e-6 to 0.01: right, although 1 − T keeps few digits."""
    for exponent in (-6, -4, -2):
        trial.right(scene(cloud(10.0**exponent), SIDE))


@case("optical depth from 1e-6 to 1e6")
def voxels_of_depth_10(trial: Trial) -> None:
    """Depth 10, a cumulus seen close."""
    trial.right(scene(cloud(10.0), SIDE))


@case("optical depth from 1e-6 to 1e6")
def voxels_of_depth_100(trial: Trial) -> None:
    """Depth 100: all light is within a few voxels of the surface."""
    trial.right(scene(cloud(100.0), SIDE))


@case("optical depth from 1e-6 to 1e6")
def voxels_of_depth_10000(trial: Trial) -> None:
    """Depth 1e4: all light is within the first voxel."""
    trial.right(scene(cloud(1e4), SIDE), noted="in a voxel")


@case("optical depth from 1e-6 to 1e6")
def voxels_of_depth_1000000(trial: Trial) -> None:
    """Depth 1e6: all light is within a hundredth of the first voxel, the margin in which the field falls to 0."""
    trial.right(scene(cloud(1e6), SIDE), noted="in a voxel")


@case("albedo 0", "albedo 1", methods=(ANY,))
def albedo_0_and_1(trial: Trial) -> None:
    """All absorbed: black but opaque as before. Nothing absorbed: no emission, whatever is asked for."""
    half = trial.render(scene(cloud(3.0), SIDE))
    black = trial.render(scene(cloud(3.0, albedo=(0.0,) * 3), SIDE))
    trial.measure(black.color.max(), 0.0, "light scattered by a black medium")
    trial.measure(np.abs(black.alpha - half.alpha).max(), 1e-6, "opacity that depends on albedo")
    glowing = fog(3.0 / COLUMN, albedo=(1.0,) * 3, emission=(9.0,) * 3)
    white = trial.right(scene(volume(CLOUD, glowing, TURNED), SIDE))
    plain = trial.render(scene(volume(CLOUD, replace(glowing, emission=(0.0,) * 3), TURNED), SIDE))
    trial.same(white, plain, 0.0, "emission of a medium that absorbs nothing")


@case("anisotropy towards ±1", methods=(ANY,))
def narrow_phase_functions(trial: Trial) -> None:
    """Lobes almost as narrow as a beam, the sun in the picture and behind the camera."""
    for phase in ("hg", "schlick", "two_lobe"):
        for g, direction in ((0.999, (1.0, 1.0, 5.5)), (-0.999, (-1.2, -0.9, -5.5))):
            medium = fog(0.5, phase=phase, anisotropy=g, anisotropy2=-g, lobe_mix=0.3)
            trial.right(scene(sphere(medium), distant(direction)))


@case("no jump as the anisotropy passes 0 and nears its limit", methods=(ANY,))
def anisotropy_through_0_and_to_its_limit(trial: Trial) -> None:
    """Every phase function is continuous in g, where the isotropic shader takes over too."""
    for phase in PHASES:
        for path in ((-1e-5, 0.0, 1e-5), (0.9989, 0.99895, 0.999), (-0.9989, -0.99895, -0.999)):
            media = [fog(1.0, phase=phase, anisotropy=g, anisotropy2=-0.5 * g, lobe_mix=0.4) for g in path]
            images = [trial.render(scene(volume(CLOUD, m, TURNED), distant((0.4, -1.0, 0.3))), **COARSE) for m in media]
            # Of the lobe's tail at 0.999 five parts in a hundred belong to 5e-5 of g; a switch would show as more.
            trial.continuous(images, 1e-4 if path[1] == 0.0 else 0.1)


@case("extinction 100 times apart between channels")
def channels_100_apart(trial: Trial) -> None:
    """Depths of 0.1, 1 and 10: the one curve that a map stores serves all three."""
    trial.right(scene(cloud((0.1, 1.0, 10.0)), SIDE))


@case("extinction 100 times apart between channels")
def dense_channels_100_apart(trial: Trial) -> None:
    """Depths of 1, 10 and 100."""
    trial.right(scene(cloud((1.0, 10.0, 100.0)), SIDE))


@case("density times two with extinction over two, same picture", coefficients=(6,))
def density_times_two(trial: Trial) -> None:
    """Only the product of density and extinction counts."""
    plain = trial.render(scene(volume(CLOUD, fog(4.0), TURNED), SIDE), **COARSE)
    trial.same(trial.render(scene(volume(2.0 * CLOUD, fog(2.0), TURNED), SIDE), **COARSE), plain)
    doubled = fog(2.0, density_scale=2.0)
    trial.same(trial.render(scene(volume(CLOUD, doubled, TURNED), SIDE), **COARSE), plain)


@case("density outside the range of half floats", coefficients=(6,))
def voxels_of_any_magnitude(trial: Trial) -> None:
    """Voxels of any magnitude, with the extinction turned down accordingly, are the same medium."""
    plain = trial.render(scene(volume(CLOUD, fog(4.0), TURNED), SIDE), **COARSE)
    for scale in (1e-12, 1e-5, 1e5, 1e12):
        other = scene(volume(CLOUD * scale, fog(4.0 / scale), TURNED), SIDE)
        trial.same(trial.render(other, **COARSE), plain)


@case("no jump as the density passes the largest half float", methods=(ANY,))
def density_through_the_largest_half_float(trial: Trial) -> None:
    """Peaks around 65504, the largest half float, and 65520, which rounds to infinity."""
    unit, images = CLOUD / CLOUD.max(), []
    for peak in (65000.0, 65503.0, 65504.0, 65519.0, 65520.0, 66000.0):
        images.append(trial.render(scene(volume(unit * peak, fog(4.0 / peak), TURNED), SIDE), **COARSE))
    trial.continuous(images)


@case("density outside the range of half floats", coefficients=(6,))
def haze_round_a_core_10000_times_denser(trial: Trial) -> None:
    """A haze that shows, round an opaque core: both magnitudes in one grid of half floats."""
    trial.right(scene(_haze_and_core(1e4), SIDE), noted="in a voxel")


@case("density outside the range of half floats", coefficients=(6,))
def haze_round_a_core_100000000_times_denser(trial: Trial) -> None:
    """The same, where the haze is less than the smallest half float times the core."""
    trial.right(scene(_haze_and_core(1e8), SIDE), noted="half")


def _haze_and_core(ratio: float) -> Volume:
    values = np.array(smooth_noise((13, 13, 13), seed=5))
    values[6, 6, 6] = ratio
    return volume(values, fog(1.5), TURNED)


@case("furnace: albedo 1 under uniform light", "albedo 1", methods=(ANY,))
def furnace(trial: Trial) -> None:
    """Albedo 1 under a uniform radiance L: each view ray scatters L·(1 − T), so every pixel is L times its opacity."""
    for depth in (1e-3, 1.0, 30.0):
        held = scene(cloud((depth, 0.3 * depth, 0.1 * depth), albedo=(1.0,) * 3))
        image = trial.render(held, ambient=2.0)
        # The transmittance of the reference: 1 − T of a thin medium has few digits left in 32 bits.
        truth = reference_scene(held)
        view = reference_camera(FRONT, *SIZE)
        transmittance = reference.render(truth, view, *SIZE).transmittance
        expected = 2.0 * (1.0 - transmittance)
        # Voxels are half floats, of 11 bits.
        trial.measure(np.abs(image.color - expected).max() / expected.max(), 2e-3, "furnace off by", "%")
        trial.measure(np.abs(image.aovs["transmittance"] - transmittance).max(), 1e-3, "transmittance off by")


@case("no light gained: never brighter than without shadows", coefficients=(6,))
def never_brighter_than_without_shadows(trial: Trial) -> None:
    """Attenuation only takes light away, in every pixel and channel; a curve that rings adds none."""
    for depth in ((0.01, 0.01, 0.01), (1.0, 5.0, 20.0), (500.0, 500.0, 500.0)):
        shadowed = trial.render(scene(cloud(depth), SIDE), FRONT, **COARSE)
        free = trial.render(scene(cloud(depth), replace(SIDE, casts_shadows=False)), FRONT, **COARSE)
        excess = float((shadowed.color - free.color).max()) / float(free.color.max())
        trial.measure(max(excess, 0.0), 1e-5, "brighter than unshadowed by", "%")


@case("no jump as the optical depth or the knob passes the threshold of the maps", coefficients=(6,))
def depth_through_the_threshold(trial: Trial) -> None:
    """The adaptive range ends where T falls below the threshold: nothing jumps as the whole cloud gets there."""
    deep = -np.log(0.01)
    for path in ([deep * (1.0 + d) for d in (-2e-3, -1e-4, 0.0, 1e-4, 2e-3)],):
        trial.continuous([trial.render(scene(cloud(d), SIDE), **COARSE) for d in path], 4e-3)
    knob = [0.0099, 0.01, 0.0101]
    trial.continuous([trial.render(scene(cloud(2.0 * deep), SIDE), threshold=t, **COARSE) for t in knob], 4e-3)


@case("no jump as the optical depth passes the opacity cutoff", methods=(ANY,))
def depth_through_the_opacity_cutoff(trial: Trial) -> None:
    """A view ray ends where it transmits less than 1e-4: the light behind it fades before."""
    deep = -np.log(1e-4)
    images = [trial.render(scene(sphere(fog(0.5 * deep * f)), SIDE)) for f in (0.99999, 1.0, 1.00001)]
    trial.continuous(images)
    trial.measure(np.abs(images[0].alpha - images[2].alpha).max(), 1.2e-4, "jump of opacity")
