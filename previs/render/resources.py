"""Textures and buffers that outlive a frame: field atlases, light-map atlases, meshes, image targets.

Each store makes what a plan asks for and frees what no plan asks for any more. None of them decides when to: the
passes do.
"""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Hashable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field

import moderngl
import numpy as np

from ..description import Field, Geometry, Mesh
from .bricks import ONE_BRICK
from .fields import LARGE_BLOCK, PackedField, PackedStore
from .method import method_of
from .planned import Plan

NEAREST = (moderngl.NEAREST, moderngl.NEAREST)
LINEAR = (moderngl.LINEAR, moderngl.LINEAR)


@dataclass(frozen=True, eq=False)
class Placement:
    """Where a field lies in its atlas: its unit box to atlas coordinates, the value of a texel of 1, and box → local.

    `cells_scale` is the number of its cells that the box spans, `cells_offset` the first texel of them, and `cell_edge`
    their edge in intervals between voxels; zeros in an atlas without cells. `occupied` are the centres of those that
    are not empty, (K, 3) in box coordinates. Box coordinate b is at
    ``b · bricks_scale + bricks_shift`` bricks from the one whose entry is at `bricks_offset` of the table, and `scale`
    is that of a brick; a dense block is one brick. `background` is the value, in texels, where no brick is stored.
    """

    scale: np.ndarray
    offset: np.ndarray
    value: float
    box_to_local: np.ndarray
    cells_scale: np.ndarray = field(default_factory=lambda: np.zeros(3))
    cells_offset: np.ndarray = field(default_factory=lambda: np.zeros(3))
    cell_edge: int = 0
    occupied: np.ndarray = field(default_factory=lambda: np.zeros((0, 3)))
    bricks_scale: np.ndarray = field(default_factory=lambda: np.ones(3))
    bricks_shift: np.ndarray = field(default_factory=lambda: np.zeros(3))
    bricks_offset: np.ndarray = field(default_factory=lambda: np.zeros(3))
    background: float = 0.0

    def scale_row(self) -> tuple[float, ...]:
        """Row of a uniform block: scale and value."""
        return (*self.scale, self.value)

    def offset_row(self) -> tuple[float, ...]:
        """Row of a uniform block: offset, and a free slot."""
        return (*self.offset, 0.0)

    def brick_rows(self) -> np.ndarray:
        """Three rows of a uniform block: scale and background, shift, offset, with free slots."""
        rows = np.zeros((3, 4))
        rows[:, :3] = self.bricks_scale, self.bricks_shift, self.bricks_offset
        rows[0, 3] = self.background
        return rows


def pack_boxes(
    sizes: Sequence[tuple[int, int, int]], limit: int
) -> tuple[tuple[int, int, int], list[tuple[int, int, int]]]:
    """Place boxes in one larger box: shelves of rows of boxes, largest first.

    Returns:
        The size of the large box, and the corner of every box in the order given.

    Raises:
        MemoryError: when they do not fit a box with edges of at most `limit`.
    """
    best = None
    order = sorted(
        range(len(sizes)), key=lambda i: sizes[i][2] * 2**32 + sizes[i][1] * 2**16 + sizes[i][0], reverse=True
    )
    widest = max(s[0] for s in sizes)
    deepest = max(s[1] for s in sizes)
    for columns in range(1, len(sizes) + 1):
        for rows in range(1, -(-len(sizes) // columns) + 1):
            width, height = min(widest * columns, limit), min(deepest * rows, limit)
            corners: list[tuple[int, int, int]] = [(0, 0, 0)] * len(sizes)
            x = y = z = row_height = shelf = right = top = 0
            for i in order:
                w, h, d = sizes[i]
                if x + w > width:
                    x, y, row_height = 0, y + row_height, 0
                if y + h > height:
                    x, y, z, row_height, shelf = 0, 0, z + shelf, 0, 0
                corners[i] = (x, y, z)
                right, top = max(right, x + w), max(top, y + h)
                x, row_height, shelf = x + w, max(row_height, h), max(shelf, d)
            if z + shelf <= limit:
                volume = right * top * (z + shelf)
                if best is None or volume < best[0]:
                    best = (volume, (right, top, z + shelf), corners)
        if columns * columns > 4 * len(sizes):
            break
    if best is None:
        raise MemoryError(f"{len(sizes)} fields do not fit a 3D texture of {limit}³")
    return best[1], best[2]


@dataclass(eq=False)
class _Voxels:
    """One 3D texture, the blocks in it, and the atlases that use it. `serial` moves when its content does."""

    texture: moderngl.Texture3D | None = None
    blocks: dict[Hashable, PackedField] = field(default_factory=dict)
    corners: dict[Hashable, tuple[int, int, int]] = field(default_factory=dict)
    cells: moderngl.Texture3D | None = None
    cell_corners: dict[Hashable, tuple[int, int, int]] = field(default_factory=dict)
    bricks: moderngl.Texture3D | None = None
    brick_corners: dict[Hashable, tuple[int, int, int]] = field(default_factory=dict)
    serial: int = 0
    users: set[FieldAtlas] = field(default_factory=set)

    def free(self) -> None:
        for texture in (self.texture, self.cells, self.bricks):
            if texture is not None:
                texture.release()
        if self.texture is not None:
            self.serial = next(_serials)
        self.texture, self.blocks, self.corners = None, {}, {}
        self.cells, self.cell_corners = None, {}
        self.bricks, self.brick_corners = None, {}


_serials = itertools.count(1)


def _hollow(block: PackedField) -> PackedField:
    """A block of the same shape, whose values and table take no memory."""
    bricks = block.bricks
    if bricks is not None:
        bricks = dataclasses.replace(bricks, table=np.broadcast_to(bricks.table.dtype.type(0), bricks.table.shape))
    values = np.broadcast_to(block.values.dtype.type(0), block.values.shape)
    cells = block.cells if block.given_cells is not None or "cells" in block.__dict__ else None
    return dataclasses.replace(block, values=values, bricks=bricks, given_cells=cells)


class FieldAtlas:
    """All fields of one role (density, temperature, emission) in one 3D texture; equal fields share their voxels.

    Args:
        context: to make the texture in.
        components: of a texel, 1 or 4.
        packed: where packed fields are taken from.
        share: another atlas of the same context and components, whose texture this one uses too. Whoever asks for
            other fields replaces its content; `serial` tells.
        with_cells: whether to hold the cells of the fields too.
    """

    def __init__(
        self,
        context: moderngl.Context,
        components: int,
        packed: PackedStore,
        share: FieldAtlas | None = None,
        with_cells: bool = False,
    ) -> None:
        self._context, self._components, self._packed = context, components, packed
        self._with_cells = with_cells
        self._voxels = share._voxels if share is not None else _Voxels()
        self.placements: dict[str, Placement] = {}

    @property
    def texture(self) -> moderngl.Texture3D | None:
        """The texture; None where nothing is held."""
        return self._voxels.texture if self in self._voxels.users else None

    @property
    def cells(self) -> moderngl.Texture3D | None:
        """The texture of the cells; None where nothing is held, or without cells."""
        return self._voxels.cells if self in self._voxels.users else None

    @property
    def bricks(self) -> moderngl.Texture3D | None:
        """The tables of bricks; None where nothing is held, or nothing in bricks."""
        return self._voxels.bricks if self in self._voxels.users else None

    @property
    def serial(self) -> int:
        """A number that moves when the texture is made anew, by whomever; 0 while this atlas holds no fields."""
        return self._voxels.serial if self in self._voxels.users else 0

    def update(self, fields: dict[str, Field], memory: int, limit: int, sparse: str = "off") -> None:
        """Hold these fields (by volume path) and no others, but for those that somebody else uses; upload only when a
        field entered or left. `memory`, `limit` and `sparse` are those of `fields.pack`."""
        if not fields:
            self.release()
            return
        voxels = self._voxels
        wanted = {(f.key, memory, limit, sparse): f for f in fields.values()}
        shared = bool(voxels.users - {self})
        voxels.users.add(self)
        if set(wanted) - set(voxels.blocks) if shared else set(wanted) != set(voxels.blocks):
            kept = {k: b for k, b in voxels.blocks.items() if b.nbytes <= LARGE_BLOCK}
            self._upload(
                {k: kept.get(k) or self._packed.take(f, *k[1:3], self._components, sparse) for k, f in wanted.items()},
                limit,
            )
        atlas = np.array(voxels.texture.size, float)
        self.placements = {}
        for path, f in fields.items():
            key = (f.key, memory, limit, sparse)
            block = voxels.blocks[key]
            size = np.array(block.size, float)
            # The block's transform belongs to the field that was packed; this one may sit elsewhere.
            box_to_local = block.box_to_index @ np.asarray(f.index_to_local, float)
            corner = np.array(voxels.corners[key], float)
            more = {}
            if self._with_cells:
                more["cell_edge"] = block.cells[1]
                more["cells_scale"] = block.intervals / block.cells[1]
                more["occupied"] = block.occupied / more["cells_scale"]
                more["cells_offset"] = np.array(voxels.cell_corners[key], float)
            if voxels.bricks is not None:
                more["bricks_offset"] = np.array(voxels.brick_corners[key], float)
            span = size - 1.0
            if (bricks := block.bricks) is not None:
                span = np.full(3, float(bricks.edge))
                more["bricks_scale"] = bricks.intervals / bricks.edge
                more["bricks_shift"], more["background"] = bricks.shift, bricks.background
            scale, offset = span / atlas, (corner + 0.5) / atlas
            self.placements[path] = Placement(scale, offset, block.scale, box_to_local, **more)

    def _upload(self, blocks: dict[Hashable, PackedField], limit: int) -> None:
        voxels = self._voxels
        voxels.free()
        keys = list(blocks)
        voxels.texture, corners = self._packed_texture([self._shaped(blocks[k]) for k in keys], limit)
        for key, corner in zip(keys, corners, strict=True):
            self._write_slabs(voxels.texture, blocks[key], corner)
        voxels.texture.filter = LINEAR
        voxels.serial = next(_serials)
        voxels.corners = dict(zip(keys, corners, strict=True))
        if self._with_cells:
            voxels.cells, corners = self._packed_texture([blocks[k].cells[0] for k in keys], limit)
            voxels.cells.filter = NEAREST
            voxels.cell_corners = dict(zip(keys, corners, strict=True))
        if any(b.bricks is not None for b in blocks.values()):
            tables = [b.bricks.table if b.bricks is not None else ONE_BRICK for b in blocks.values()]
            voxels.bricks, corners = self._packed_texture(tables, limit, "u4")
            voxels.bricks.filter = NEAREST
            voxels.brick_corners = dict(zip(keys, corners, strict=True))
        voxels.blocks = {k: b if b.nbytes <= LARGE_BLOCK else _hollow(b) for k, b in blocks.items()}

    def _packed_texture(
        self, blocks: Sequence[np.ndarray], limit: int, dtype: str = "f2"
    ) -> tuple[moderngl.Texture3D, list[tuple[int, int, int]]]:
        """One texture of several blocks (z, y, x[, components]), and where each of them begins."""
        sizes = [tuple(reversed(b.shape[:3])) for b in blocks]
        components = blocks[0].shape[3] if blocks[0].ndim == 4 else 1
        size, corners = pack_boxes(sizes, limit)
        alone = len(blocks) == 1 and blocks[0].flags.c_contiguous
        texture = self._context.texture3d(size, components, blocks[0] if alone else None, dtype=dtype)
        if not alone:
            for block, box, corner in zip(blocks, sizes, corners, strict=True):
                if block.flags.c_contiguous:
                    texture.write(block, viewport=(*corner, *box))
        texture.repeat_x = texture.repeat_y = texture.repeat_z = False
        return texture, corners

    @staticmethod
    def _write_slabs(texture: moderngl.Texture3D, block: PackedField, corner: tuple[int, int, int]) -> None:
        x, y, z = corner
        for first, slab in block.slabs() if block.slabs is not None else ():
            depth, height, width = slab.shape
            texture.write(slab, viewport=(x, y, z + first, width, height, depth))
            del slab  # before the next is made

    def _shaped(self, block: PackedField) -> np.ndarray:
        """The block's values with the atlas's number of components; only their shape where they come in slabs."""
        if block.slabs is not None:
            return block.values
        values = block.scalars if self._components == 1 else block.values
        if self._components == 4 and values.ndim == 3:
            values = np.repeat(values[..., None], 4, axis=-1)
        return np.ascontiguousarray(values)

    def release(self) -> None:
        """Hold nothing; the texture goes with its last user."""
        self._voxels.users.discard(self)
        if not self._voxels.users:
            self._voxels.free()
        self.placements = {}


class MapAtlas:
    """The transmittance maps of all pairs of light and volume, as tiles of one set of textures.

    `owners` are the names of the passes that filled its tiles last.
    """

    def __init__(self, context: moderngl.Context) -> None:
        self._context = context
        self._shape: Hashable = None
        self.values: list[moderngl.Texture] = []
        self.range: moderngl.Texture | None = None
        self.framebuffer: moderngl.Framebuffer | None = None
        self.owners: dict[int, str] = {}

    @staticmethod
    def _shape_of(plan: Plan) -> Hashable:
        layout, settings = plan.map_atlas, plan.settings
        method = method_of(settings)
        return layout.size, layout.columns, method.name, method.layers(settings)

    def update(self, plan: Plan) -> bool:
        """Make the textures for a plan; True when they are new and every map has to be filled again."""
        shape, wanted = self._shape_of(plan), plan.map_atlas.extent
        fits = self.framebuffer is not None and shape == self._shape
        if fits and not _is_to_resize(self.framebuffer.size, wanted):
            return False
        before = (self.framebuffer, *self._textures()) if fits else ()
        owners = self.owners if fits else {}
        if not fits:
            self.release()
        self.values = [self._context.texture(wanted, 4, dtype="f2") for _ in range(shape[-1])]
        # Range ends need 32 bits: half floats cost up to 19 dB in dense media.
        self.range = self._context.texture(wanted, 4, dtype="f4")
        for texture in self._textures():
            texture.filter = NEAREST if method_of(plan.settings).adaptive else LINEAR
            texture.repeat_x = texture.repeat_y = False
        self.framebuffer = self._context.framebuffer(self._textures())
        self._shape = shape
        self.owners = {t: name for t, name in owners.items() if t < plan.map_atlas.capacity}
        if before:
            self._context.copy_framebuffer(self.framebuffer, before[0])
            self.framebuffer.use()
            for resource in before:
                resource.release()
        return not before

    def _textures(self) -> list[moderngl.Texture]:
        return [*self.values, *([self.range] if self.range is not None else [])]

    def owner(self, plan: Plan, tile: int) -> str | None:
        """The name of the pass whose map is in a tile of the plan; None where there is none that fits the plan."""
        return self.owners.get(tile) if self._shape == self._shape_of(plan) else None

    def release(self) -> None:
        """Free the textures."""
        if self.framebuffer is not None:
            for resource in (self.framebuffer, *self._textures()):
                resource.release()
        self.values, self.range, self.framebuffer, self._shape = [], None, None, None
        self.owners = {}


def _is_to_resize(held: tuple[int, int], wanted: tuple[int, int]) -> bool:
    """Whether an atlas is too small for a plan, or far too large."""
    return held[0] < wanted[0] or held[1] < wanted[1] or held[0] * held[1] > 4 * wanted[0] * wanted[1]


class ShadowAtlas:
    """The shadow maps of all lights, a tile for every face; `owners` are the names of the passes that filled them."""

    def __init__(self, context: moderngl.Context) -> None:
        self._context = context
        self._shape: Hashable = None
        self.texture: moderngl.Texture | None = None
        self.framebuffer: moderngl.Framebuffer | None = None
        self.owners: dict[int, str] = {}

    def update(self, plan: Plan) -> bool:
        """Make the texture for a plan; True when it is new."""
        layout = plan.shadow_atlas
        fits = self.texture is not None and self._shape == (layout.size, layout.columns)
        if fits and not _is_to_resize(self.texture.size, layout.extent):
            return False
        before, owners = (self.framebuffer, self.texture), self.owners
        self.texture = self._context.depth_texture(layout.extent)
        self.texture.compare_func = "<="
        self.texture.filter = LINEAR
        self.texture.repeat_x = self.texture.repeat_y = False
        self.framebuffer = self._context.framebuffer(depth_attachment=self.texture)
        self._shape = (layout.size, layout.columns)
        self.owners = {t: name for t, name in owners.items() if t < layout.capacity} if fits else {}
        for tile in self.owners:
            # OpenGL copies depth between framebuffers too, but moderngl does not.
            viewport = (*layout.corner(tile), layout.size, layout.size)
            self.texture.write(before[0].read(viewport, 1, -1, dtype="f4"), viewport)
        if before[0] is not None:
            self.framebuffer.use()
            before[0].release()
            before[1].release()
        return not fits

    def _textures(self) -> list[moderngl.Texture]:
        return [*self.values, *([self.range] if self.range is not None else [])]

    def owner(self, plan: Plan, tile: int) -> str | None:
        """The name of the pass whose map is in a tile of the plan; None where there is none that fits the plan."""
        shape = (plan.shadow_atlas.size, plan.shadow_atlas.columns)
        return self.owners.get(tile) if self._shape == shape else None

    @contextmanager
    def plain(self) -> Iterator[moderngl.Texture | None]:
        """The texture, to be read as depths and not compared with one; None where there is none."""
        if self.texture is None:
            yield None
            return
        self.texture.compare_func = ""
        try:
            yield self.texture
        finally:
            self.texture.compare_func = "<="

    def tiling(self, plan: Plan) -> tuple[float, float, float, float]:
        """The `shadow_tiling` uniform."""
        layout = plan.shadow_atlas
        width, height = self.texture.size
        return (layout.size / width, layout.size / height, float(layout.columns), 0.5 / layout.size)

    def release(self) -> None:
        """Free the texture."""
        for resource in (self.framebuffer, self.texture):
            if resource is not None:
                resource.release()
        self.texture, self.framebuffer, self._shape = None, None, None
        self.owners = {}


@dataclass(eq=False)
class _GeometryBuffers:
    vertices: moderngl.Buffer
    indices: moderngl.Buffer


@dataclass(eq=False)
class _InstanceBuffer:
    buffer: moderngl.Buffer
    count: int


@dataclass(eq=False)
class _Shapes:
    """The buffers of all stores that share them: vertices by geometry, matrices by instances and origin."""

    geometries: dict[Hashable, _GeometryBuffers] = field(default_factory=dict)
    instances: dict[Hashable, _InstanceBuffer] = field(default_factory=dict)
    users: set[MeshStore] = field(default_factory=set)

    def free_unused(self) -> None:
        geometries = {key for user in self.users for key in user.geometries}
        instances = {key for user in self.users for key in user.instances.values()}
        for key in set(self.geometries) - geometries:
            buffers = self.geometries.pop(key)
            buffers.vertices.release()
            buffers.indices.release()
        for key in set(self.instances) - instances:
            self.instances.pop(key).buffer.release()


class MeshStore:
    """Vertex buffers by geometry and instance matrices by mesh.

    Args:
        context: to make the buffers in.
        share: another store of the same context: what both hold is there once.
    """

    def __init__(self, context: moderngl.Context, share: MeshStore | None = None) -> None:
        self._context = context
        self._shapes = share._shapes if share is not None else _Shapes()
        self._shapes.users.add(self)
        #: Keys of what this store holds: geometries, and instances by the path of their mesh.
        self.geometries: set[Hashable] = set()
        self.instances: dict[str, Hashable] = {}

    def update(self, meshes: Sequence[Mesh], origin: np.ndarray) -> None:
        """Hold exactly these meshes, their instances placed relative to `origin`."""
        shapes = self._shapes
        shapes.users.add(self)
        self.geometries = {m.geometry.key for m in meshes if len(m.geometry.triangles)}
        self.instances = {m.path: (m.parts()["shape"], origin.tobytes()) for m in meshes}
        shapes.free_unused()
        for mesh in meshes:
            geometry, key = mesh.geometry, self.instances[mesh.path]
            if geometry.key in self.geometries and geometry.key not in shapes.geometries:
                shapes.geometries[geometry.key] = self._upload(geometry)
            if key not in shapes.instances:
                matrices = np.array(mesh.local_to_world, float).reshape(-1, 4, 4)
                matrices[:, 3, :3] -= origin
                data = matrices.astype(np.float32).tobytes()
                shapes.instances[key] = _InstanceBuffer(self._context.buffer(data), len(matrices))

    def _upload(self, geometry: Geometry) -> _GeometryBuffers:
        count = len(geometry.points)
        colors = geometry.colors if geometry.colors is not None else np.ones((count, 3), np.float32)
        vertices = np.concatenate([geometry.points, geometry.normals, colors], axis=1, dtype=np.float32)
        return _GeometryBuffers(
            self._context.buffer(np.ascontiguousarray(vertices).tobytes()),
            self._context.buffer(np.ascontiguousarray(geometry.triangles, np.uint32).tobytes()),
        )

    def draw(self, mesh: Mesh, program: moderngl.Program, layout: str, attributes: Sequence[str]) -> None:
        """Draw all instances of a mesh. `layout` and `attributes` name what the program reads of a vertex."""
        if mesh.geometry.key not in self.geometries:
            return
        buffers = self._shapes.geometries[mesh.geometry.key]
        instances = self._shapes.instances[self.instances[mesh.path]]
        content = [(buffers.vertices, layout, *attributes), (instances.buffer, "16f4/i", "in_instance")]
        vertex_array = self._context.vertex_array(program, content, index_buffer=buffers.indices)
        vertex_array.render(instances=instances.count)
        vertex_array.release()

    def release(self) -> None:
        """Hold nothing; buffers go with their last user."""
        self.geometries, self.instances = set(), {}
        self._shapes.users.discard(self)
        self._shapes.free_unused()


class Targets:
    """The textures of one image size that passes draw into, made when first asked for.

    `get(name, formats, depth)` gives a framebuffer whose colour attachments have the given formats ("f2" or "f4", four
    components).
    """

    def __init__(self, context: moderngl.Context) -> None:
        self._context = context
        self._held: dict[str, tuple[Hashable, moderngl.Framebuffer]] = {}

    def get(
        self, name: str, size: tuple[int, int], formats: Sequence[str], depth: bool = False
    ) -> moderngl.Framebuffer:
        """The framebuffer of that name, made anew when its shape changed."""
        shape = (size, tuple(formats), depth)
        held = self._held.get(name)
        if held is not None and held[0] == shape:
            return held[1]
        if held is not None:
            self._free(held[1])
        colors = []
        for dtype in formats:
            texture = self._context.texture(size, 4, dtype=dtype)
            texture.filter = NEAREST
            texture.repeat_x = texture.repeat_y = False
            colors.append(texture)
        attachment = self._context.depth_renderbuffer(size) if depth else None
        framebuffer = self._context.framebuffer(colors, attachment)
        self._held[name] = (shape, framebuffer)
        return framebuffer

    def __getitem__(self, name: str) -> moderngl.Framebuffer:
        return self._held[name][1]

    def __contains__(self, name: str) -> bool:
        return name in self._held

    def keep(self, names: set[str]) -> None:
        """Free the framebuffers of other names."""
        for name in set(self._held) - names:
            self._free(self._held.pop(name)[1])

    @staticmethod
    def _free(framebuffer: moderngl.Framebuffer) -> None:
        attachments = [*framebuffer.color_attachments, framebuffer.depth_attachment]
        framebuffer.release()
        for attachment in attachments:
            if attachment is not None:
                attachment.release()

    def release(self) -> None:
        """Free everything."""
        for _, framebuffer in self._held.values():
            self._free(framebuffer)
        self._held.clear()
