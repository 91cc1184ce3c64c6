"""UsdVol volumes and homogeneous shapes: density fields, or a box, sphere or capsule of density 1.

A field's values sit at integer index coordinates; index space goes to the volume's local space by the grid's transform
and then by the field prim's own local transform (`xformOpOrder` of the field prim alone, whatever prims lie between it
and the volume), and from there to the world by the volume's transform.
"""

from __future__ import annotations

import numpy as np
from pxr import Gf, Sdf, Usd, UsdGeom, UsdVol

from ..description import Box, Capsule, Field, Medium, Note, Shape, Sphere, Volume
from ..errors import PrevisError
from .context import Context, Placement, Translation
from .field import LoadedGrid, read_field
from .material import bound_material, previs_volume_shader, read_medium
from .values import as_float, attribute_value, numpy_matrix

#: The fields that a volume uses, by the names of their relationships.
USED_FIELDS = ("density", "temperature", "emission")


def read_volume(prim: Usd.Prim, placement: Placement, context: Context, out: Translation) -> None:
    """Translate a UsdVol.Volume.

    Raises `PrevisError` when a field cannot be read, unless the context keeps going: then the volume is left out with a
    note.
    """
    try:
        _read_volume(prim, placement, context, out)
    except PrevisError as error:
        if not context.keep_going:
            raise
        subject, _, message = str(error).partition(": ")
        out.note("missing", subject, f"{message}; the volume is left out")
        # The file may be there by the next time.
        out.varying = True


def _read_volume(prim: Usd.Prim, placement: Placement, context: Context, out: Translation) -> None:
    names = _field_prims(prim, context, out)
    density_name = _density_name(prim, names, context, out)
    material = bound_material(prim, out)
    medium = read_medium(prim, material, context.time, out)
    shape = density = None
    if density_name is None:
        shape = _extent_box(prim, context)
        if not _has_thickness(shape):
            out.note("empty", prim, "its extent has no thickness; the volume is left out")
            return
        # A box is what a PrevisVolume without fields is; another shader may shape the density itself.
        foreign = material is not None and previs_volume_shader(material, out) is None
        if foreign or UsdVol.Volume(prim).GetFieldPaths():
            out.note("approximated", prim, "has no density field: shown as a box of density 1 in its extent")
    else:
        density = _read_field(prim, density_name, names, context, out)
        if density is None:
            return
        if np.ndim(density.grid.background) > 0:
            raise PrevisError(
                f"{names[density_name].GetPath()}: the grid {density.grid.name} holds vectors; a density is a number"
            )
    extra = {
        name: _read_field(prim, name, names, context, out)
        for name in ("temperature", "emission")
        if name in names and name != density_name
    }
    for name in names:
        if name not in (*USED_FIELDS, density_name):
            out.note("ignored", prim, f"field:{name}")
    _add(prim, placement, out, medium, density=density, shape=shape, **extra)


def read_homogeneous_shape(prim: Usd.Prim, placement: Placement, context: Context, out: Translation) -> None:
    """Translate a Cube, Sphere or Capsule whose material has a volume output and no surface output."""
    medium = read_medium(prim, bound_material(prim, out), context.time, out)
    shape = _gprim_shape(prim, context.time)
    if not _has_thickness(shape):
        out.note("empty", prim, "has no thickness; it is left out")
        return
    _add(prim, placement, out, medium, shape=shape)


def _add(
    prim: Usd.Prim,
    placement: Placement,
    out: Translation,
    medium: Medium,
    density: Field | None = None,
    shape: Shape | None = None,
    temperature: Field | None = None,
    emission: Field | None = None,
) -> None:
    for k, matrix in enumerate(placement.matrices):
        path = f"{prim.GetPath()}{placement.label(k)}"
        if not np.all(np.isfinite(matrix)) or np.linalg.det(matrix[:3, :3]) == 0.0:
            out.note("empty", path, "its transform has no thickness; it is left out")
            continue
        out.volumes.append(Volume(path, matrix, medium, density, shape, temperature, emission))


def _field_prims(prim: Usd.Prim, context: Context, out: Translation) -> dict[str, Usd.Prim]:
    """The OpenVDBAsset prims of a volume by field name; other kinds are reported.

    A target that does not exist is an error, and so is a density that is no field at all.
    """
    found = {}
    for name, path in sorted(UsdVol.Volume(prim).GetFieldPaths().items()):
        path = Sdf.Path(path)
        target = context.stage.GetPrimAtPath(path)
        if not target:
            raise PrevisError(f"{prim.GetPath()}: field:{name} points to {path}, which does not exist")
        out.depend(target)
        if not target.IsA(UsdVol.OpenVDBAsset):
            kind = target.GetTypeName()
            what = f"{'an' if kind[:1] in tuple('AEIOU') else 'a'} {kind}" if kind else "a prim without a type"
            if target.IsA(UsdVol.FieldBase):
                out.note("ignored", target, f"{what} is not read as a field")
                continue
            message = f"field:{name} points to <{path}>, which is {what} and not an OpenVDBAsset"
            if name == "density":
                raise PrevisError(f"{prim.GetPath()}: {message}")
            out.note("ignored", prim, message)
            continue
        found[name] = target
    return found


def _density_name(prim: Usd.Prim, fields: dict[str, Usd.Prim], context: Context, out: Translation) -> str | None:
    """Which field is the density: the one so named, or the only one that can be; None for a volume without."""
    if "density" in fields:
        return "density"
    scalars = [
        name
        for name, target in fields.items()
        if name not in USED_FIELDS
        and attribute_value(target, "fieldDataType", context.time, "float") in ("float", "half", "double", "int")
    ]
    by_grid = [n for n in scalars if attribute_value(fields[n], "fieldName", context.time) == "density"]
    candidates = by_grid if len(by_grid) == 1 else scalars
    if not candidates:
        return None
    if len(candidates) > 1:
        known = ", ".join(candidates)
        raise PrevisError(f"{prim.GetPath()}: no field named density, and several that might be: {known}")
    out.note("approximated", prim, f"has no field named density; field:{candidates[0]} is read as density")
    return candidates[0]


def _read_field(
    prim: Usd.Prim, name: str, fields: dict[str, Usd.Prim], context: Context, out: Translation
) -> Field | None:
    """The field of that name, None (with a note) for an empty grid."""
    target = fields[name]
    out.fields.setdefault(target.GetPath(), name)
    loaded, notes = read_field(target, context.time, context.grids)
    out.grid_files[loaded.key] = loaded.file
    out.notes.extend(notes)
    if loaded.grid.active_count == 0:
        consequence = "the volume is left out" if name not in ("temperature", "emission") else "the field is left out"
        out.notes.append(
            Note("empty", str(target.GetPath()), f"grid {loaded.grid.name} has no active voxels; {consequence}")
        )
        return None
    return Field(loaded.key, loaded.grid, _index_to_local(loaded, target, context, out))


def _index_to_local(loaded: LoadedGrid, target: Usd.Prim, context: Context, out: Translation) -> np.ndarray:
    """The grid's transform, then the field prim's own local one."""
    own = UsdGeom.Xformable(target).GetLocalTransformation(context.time)
    matrix = np.asarray(loaded.grid.index_to_world, float)
    if own != Gf.Matrix4d(1.0):
        matrix = matrix @ numpy_matrix(own)
        out.note("approximated", target, "its own transform is applied between the grid's and the volume's")
    return matrix


def _extent_box(prim: Usd.Prim, context: Context) -> Box:
    extent = attribute_value(prim, "extent", context.time)
    if extent is None or len(extent) != 2:
        raise PrevisError(
            f"{prim.GetPath()}: has neither a density field nor an extent; author field:density or extent"
        )
    return Box(tuple(float(c) for c in extent[0]), tuple(float(c) for c in extent[1]))


def _has_thickness(shape: Shape) -> bool:
    lo, hi = shape.local_bounds
    return bool(np.all(np.isfinite(lo)) and np.all(np.isfinite(hi)) and np.all(hi > lo))


def _gprim_shape(prim: Usd.Prim, time: Usd.TimeCode) -> Shape:
    def size(name: str, default: float) -> float:
        return as_float(attribute_value(prim, name, time, default)) or 0.0

    kind = prim.GetTypeName()
    if kind == "Cube":
        half = 0.5 * size("size", 2.0)
        return Box((-half,) * 3, (half,) * 3)
    if kind == "Sphere":
        return Sphere(size("radius", 1.0))
    axis = str(attribute_value(prim, "axis", time, "Z"))
    return Capsule(axis, max(size("height", 1.0), 0.0), size("radius", 0.5))
