"""What the passes of a frame share: the context, the stores, and how programs are given their inputs."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterator, Sequence
from typing import Any

import moderngl
import numpy as np

from .. import blackbody
from . import uniforms
from .covered import common
from .fields import PackedStore
from .pieces import Box, Kind, Pace, Piece
from .planned import Plan
from .resources import FieldAtlas, MapAtlas, MeshStore, ShadowAtlas, Targets
from .shader import Program, ShaderCache
from .slices import SliceAtlas

#: Texture units by sampler name. GL 3.3 guarantees 48 of them, and 16 samplers in one fragment shader.
UNITS = {
    "density_atlas": 0,
    "shadow_atlas": 1,
    "shadow_depths": 1,
    "map_range": 2,
    "light_slices": 3,
    "previous_depth": 4,
    "map_values0": 3,
    "map_values1": 4,
    "map_values2": 5,
    "map_values3": 6,
    "map_values4": 7,
    "gbuffer_normal_distance": 8,
    "gbuffer_diffuse_roughness": 9,
    "gbuffer_specular": 10,
    "gbuffer_emissive": 11,
    "temperature_atlas": 12,
    "emission_atlas": 13,
    "scattered_pixels": 15,
    "density_cells": 16,
    "density_bricks": 17,
    "previous_scattered": 9,
    "previous_transmittance": 10,
    "previous_emission": 11,
    "march_scattered": 0,
    "march_transmittance": 1,
    "march_emission": 2,
    "surface_radiance": 3,
}

#: Distance written where a view ray meets no mesh.
BACKGROUND_DISTANCE = 1e30


class Shared:
    """What the renderers that share in one context have in common beyond their stores, and how many they are."""

    def __init__(self, context: moderngl.Context) -> None:
        self.context = context
        self.shaders = ShaderCache(context, UNITS)
        self.packed = PackedStore()
        # moderngl binds the last used framebuffer again after making one, and must not find it released.
        self.idle = context.simple_framebuffer((1, 1))
        self.users: set[Frame] = set()

    def release(self) -> None:
        """Free everything."""
        self.shaders.release()
        self.packed.clear()
        # The context may live on, and moderngl would bind the last used framebuffer again.
        self.context.detect_framebuffer(0).use()
        self.idle.release()


class Frame:
    """The stores of a renderer together with the plan being drawn.

    Between two pieces of a pass anything may be drawn in the same context: nothing that is bound or enabled survives
    it, only textures, buffers and framebuffers do.

    Args:
        context: to draw in.
        share: another frame of the same context, whose programs, voxels and meshes this one uses too.
    """

    def __init__(self, context: moderngl.Context, share: Frame | None = None) -> None:
        self.context = context
        self.shared = share.shared if share is not None else Shared(context)
        self.shared.users.add(self)
        self.shaders, packed = self.shared.shaders, self.shared.packed
        self.density = FieldAtlas(context, 1, packed, share and share.density, with_cells=True)
        self.temperature = FieldAtlas(context, 1, packed, share and share.temperature)
        self.emission = FieldAtlas(context, 4, packed, share and share.emission)
        self.maps = MapAtlas(context)
        self.slices = SliceAtlas(context)
        self.shadows = ShadowAtlas(context)
        self.meshes = MeshStore(context, share and share.meshes)
        self.targets = Targets(context)
        self.pace = Pace(context)
        self._plan: Plan | None = None
        self._packed: dict[tuple[str, Hashable], bytes] = {}
        self._buffers: dict[int, moderngl.Buffer] = {}
        self._blackbody: moderngl.Buffer | None = None
        self._pixels: tuple[tuple[str, int], moderngl.Texture] | None = None

    @property
    def plan(self) -> Plan:
        """The plan being drawn."""
        assert self._plan is not None
        return self._plan

    @plan.setter
    def plan(self, plan: Plan) -> None:
        if plan is not self._plan:
            self._packed.clear()
        self._plan = plan

    def light_atlas(self, plan: Plan) -> MapAtlas | SliceAtlas:
        """Where the transmittance maps of a plan are."""
        return self.slices if plan.map_slices else self.maps

    def forget_placements(self) -> None:
        """Pack uniform blocks anew: fields have moved in their atlases."""
        self._packed.clear()

    def pieces(self, kind: Kind, size: tuple[int, int], first: float = 0.0, last: float = 1.0) -> Iterator[Piece]:
        """The pieces in which to draw a target of that size; see `Pace`."""
        return self.pace.pieces(kind, size, first, last)

    def fullscreen(self, fragment: str, **defines: Any) -> Program:
        """The program that runs a fragment shader over the whole target, compiled for the plan."""
        return self.shaders.get("fullscreen.vert", fragment, **{**self.plan.defines, **defines})

    def draw_fullscreen(self, program: Program) -> None:
        """Run a program made by `fullscreen` over the bound framebuffer."""
        vertex_array = self.context.vertex_array(program.program, [])
        vertex_array.render(moderngl.TRIANGLES, vertices=3)
        vertex_array.release()

    def draw_parts(
        self, program: Program, framebuffer: moderngl.Framebuffer, within: Box | None, parts: Sequence[Box] | None
    ) -> None:
        """Run a program made by `fullscreen` over parts of a framebuffer, as far as they are within a rectangle; None
        stands for all of it in both."""
        for part in (None,) if parts is None else parts:
            scissor = within if part is None else common(within, part)
            if part is None or scissor is not None:
                framebuffer.scissor = scissor
                framebuffer.use()
                self.draw_fullscreen(program)
        framebuffer.scissor = None

    def bind(self, **textures: moderngl.Texture | moderngl.Texture3D | None) -> None:
        """Bind textures to the units of the samplers of that name."""
        for name, texture in textures.items():
            if texture is not None:
                texture.use(UNITS[name])

    def bind_camera(self, program: Program) -> None:
        """Set the uniforms of camera.glsl."""
        rays = self.plan.rays
        program.set(
            camera_anchor=np.asarray(rays.anchor, np.float32).tobytes(),
            camera_direction=np.asarray(rays.direction, np.float32).tobytes(),
            camera_depths=(rays.anchor_depth, rays.near, rays.far),
        )

    def bind_pixels(self, program: Program, stride: int = 1) -> None:
        """Set the uniforms of pixel.glsl; `stride` is how many pixels of the picture lie from one texel of the target
        to the next, where the plan draws no scattered pixels."""
        plan = self.plan
        program.set(image_size=(plan.width, plan.height), pixel_stride=stride)
        if plan.pixels is None:
            return
        key = (plan.pixels.key, plan.height)
        if self._pixels is None or self._pixels[0] != key:
            if self._pixels is not None:
                self._pixels[1].release()
            texture = self.context.texture(plan.target_size, 2, plan.pixels.texels(plan.height).tobytes(), dtype="f4")
            texture.filter = (moderngl.NEAREST, moderngl.NEAREST)
            self._pixels = (key, texture)
        self.bind(scattered_pixels=self._pixels[1])

    @property
    def geometry(self) -> list[moderngl.Texture]:
        """The G-buffer of what the plan draws."""
        return self.targets["gbuffer" if self.plan.pixels is None else "gather"].color_attachments

    def bind_lighting(self, program: Program, batch: range, capacity: int | None = None) -> None:
        """Give a program everything that lights.glsl, medium.glsl and transmittance.glsl read, for one batch of
        lights. `capacity` is the program's LIGHT_CAPACITY; None where it is the plan's."""
        plan = self.plan
        capacity = capacity or plan.defines["LIGHT_CAPACITY"]
        number = (batch.start, capacity)
        self._block(program, "Volumes", 0, lambda: uniforms.pack_volumes(plan, self.density.placements))
        self._block(program, "Lights", number, lambda: uniforms.pack_lights(plan, batch, capacity))
        if plan.defines["HAS_GRIDS"] and plan.defines["HAS_MAPS"]:
            self._block(program, "LightMaps", number, lambda: uniforms.pack_light_maps(plan, batch, capacity))
            layers = {f"map_values{i}": t for i, t in enumerate(self.maps.values)}
            self.bind(map_range=self.maps.range, light_slices=self.slices.texture, **layers)
            program.set(map_size=float(plan.map_size), slice_count=float(plan.map_slices))
            if self.slices.texture is not None:
                program.set(slices_texel=tuple(1.0 / n for n in self.slices.texture.size))
        self.bind_density(program)
        if plan.shadow_tiles:
            self.bind(shadow_atlas=self.shadows.texture)
            program.set(shadow_tiling=self.shadows.tiling(plan))
        program.set(light_count=len(batch), ambient=plan.ambient, first_batch=batch.start == 0)

    def bind_density(self, program: Program) -> None:
        """Give a program what field.glsl and the cells of medium.glsl read."""
        density = self.density
        self.bind(density_atlas=density.texture, density_cells=density.cells, density_bricks=density.bricks)
        if density.texture is not None:
            program.set(density_texel=tuple(1.0 / n for n in density.texture.size))

    def bind_light_lists(self, program: Program, number: int) -> None:
        """Give a program the lists of light_list.glsl for a batch of lights."""
        plan = self.plan
        if plan.light_lists:
            lists = plan.light_lists[number]
            self._block(program, "LightLists", number, lambda: uniforms.pack_light_lists(plan, lists))

    def bind_emission(self, program: Program) -> None:
        """Give a program everything that emission.glsl reads."""
        plan = self.plan
        placements = self.temperature.placements, self.emission.placements
        self._block(program, "Emissions", 0, lambda: uniforms.pack_emissions(plan, *placements))
        if self._blackbody is None:
            self._blackbody = self.context.buffer(uniforms.pack_blackbody())
        self._blackbody.bind_to_uniform_block(uniforms.BLACKBODY_BINDING)
        program.bind_block("Blackbody", uniforms.BLACKBODY_BINDING)
        self.bind(temperature_atlas=self.temperature.texture, emission_atlas=self.emission.texture)
        lowest, highest = blackbody.TABLE_RANGE
        program.set(blackbody_range=(lowest, 1.0 / (highest - lowest)))

    def _block(self, program: Program, name: str, number: Hashable, pack: Callable[[], bytes]) -> None:
        """Fill a uniform block with what `pack` gives; the number tells blocks of one name apart in a plan."""
        binding = uniforms.BLOCKS[name]
        if (name, number) not in self._packed:
            self._packed[name, number] = pack()
        data = self._packed[name, number]
        buffer = self._buffers.get(binding)
        if buffer is None or buffer.size != len(data):
            if buffer is not None:
                buffer.release()
            buffer = self._buffers[binding] = self.context.buffer(reserve=len(data))
        buffer.write(data)
        buffer.bind_to_uniform_block(binding)
        program.bind_block(name, binding)

    def release_unused(self) -> None:
        """Free the atlases and targets that the plan does not use."""
        plan = self.plan
        used = {p.kind for p in plan.passes}
        for atlas in (self.maps, self.slices):
            if not plan.map_atlas.spans or atlas is not self.light_atlas(plan):
                atlas.release()
        if not plan.shadow_atlas.spans:
            self.shadows.release()
        if "fields" not in used:
            for atlas in (self.density, self.temperature, self.emission):
                atlas.release()
        if not plan.meshes:
            self.meshes.release()
        turns = {"march_other", "upsample_other"} if len(plan.batches) * len(plan.slices) > 1 else set()
        self.targets.keep(used | turns)

    def field_serials(self) -> tuple[int, ...]:
        """Numbers that move when the voxels held are no longer those that were uploaded for this frame."""
        return tuple(atlas.serial for atlas in (self.density, self.temperature, self.emission))

    def rest(self) -> None:
        """Leave no framebuffer bound that may be released, but the window's where there is one, and nothing enabled
        that a user interface drawn in the same context would have to know of."""
        self.context.enable_only(moderngl.NOTHING)
        (self.context.screen or self.shared.idle).use()

    def release_scene(self) -> None:
        """Free what belongs to a scene."""
        self.rest()
        for store in (
            self.density,
            self.temperature,
            self.emission,
            self.maps,
            self.slices,
            self.shadows,
            self.meshes,
            self.targets,
        ):
            store.release()

    def release(self) -> None:
        """Free everything but what others share."""
        self.release_scene()
        self.shared.users.discard(self)
        for buffer in self._buffers.values():
            buffer.release()
        self._buffers.clear()
        if self._blackbody is not None:
            self._blackbody.release()
        self._blackbody = None
        if self._pixels is not None:
            self._pixels[1].release()
        self._pixels = None
        if not self.shared.users:
            self.shared.release()
