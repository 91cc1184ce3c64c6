"""Ground truth: single scattering by adaptive quadrature in float64 NumPy, slow and plain.

`render` evaluates, at the pixel centres of a small image,

    L = ∫ T_view · (Σ_lights σs·p(cosθ)·E·V·T_light + σs·La + σa·Le) dt  +  T_view(d) · L_surface

[RTR4 eq. 14.2 to 14.5; the ambient term is TFM11 eq. 7]. Nothing is marched: optical depths are closed forms
(shapes) or exact per cell (grids), and the outer integral is an adaptive Gauss–Kronrod rule that splits its intervals
until its own error estimate is met, starting from every place where the integrand has a kink or a jump: boundaries of
volumes, faces of grid cells, edges of light cones, and the boundaries of the shadows of solids and of volumes.

What is modelled: any number of overlapping volumes (homogeneous boxes, spheres, capsules and trilinear grids under
any invertible affine transform), distant, point and spot lights, a uniform ambient radiance, and triangles with a
Lambertian surface. What is not: multiple scattering, lights of finite size (sum several point lights instead),
textures, interpolated normals, filtering over a pixel.

Conventions: matrices are 4×4 and act on row vectors, ``world = [x y z 1] @ to_world``; lengths are stage units;
colours are linear RGB. This package shares no code with the renderer, so that the two can be compared.

    from previs import reference as ref

    cloud = ref.Volume(ref.HomogeneousSphere(1.0), ref.Medium(extinction=2.0, albedo=0.9, phase="hg", anisotropy=0.4))
    scene = ref.Scene(volumes=[cloud], lights=[ref.DistantLight(direction=(0, -1, 0), irradiance=3.0)])
    camera = ref.Camera(ref.look_at(eye=(0, 0, 5), target=(0, 0, 0)), window=(-0.4, 0.4, -0.3, 0.3))
    image = ref.render(scene, camera, 64, 48)
    image.color            # (48, 64, 3) float64
"""

from previs.reference.camera import Camera, look_at
from previs.reference.density import GridMedium, HomogeneousBox, HomogeneousCapsule, HomogeneousSphere
from previs.reference.integrator import (
    ReferenceImage,
    light_transmittance,
    optical_depth,
    render,
    transmittance_along,
)
from previs.reference.lights import DistantLight, PointLight, SpotLight
from previs.reference.phase import phase_function
from previs.reference.scene import EmissionField, Medium, Scene, Volume
from previs.reference.solids import Triangles, box_triangles

__all__ = [
    "Camera",
    "DistantLight",
    "EmissionField",
    "GridMedium",
    "HomogeneousBox",
    "HomogeneousCapsule",
    "HomogeneousSphere",
    "Medium",
    "PointLight",
    "ReferenceImage",
    "Scene",
    "SpotLight",
    "Triangles",
    "Volume",
    "box_triangles",
    "light_transmittance",
    "look_at",
    "optical_depth",
    "phase_function",
    "render",
    "transmittance_along",
]
