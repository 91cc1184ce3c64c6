"""UsdGeom meshes and implicit shapes as triangles.

Polygons are cut into triangles (convex ones into fans, concave ones by clipping ears), holes are left out, left-handed
faces are turned over. A subdivision surface is shown as its control cage with smooth normals; a polygonal mesh
(`subdivisionScheme` "none") without normals is faceted. Vertices are split where normals or colours differ
between faces.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from pxr import Usd, UsdGeom, UsdShade

from ..description import Mesh, Note
from .context import Context, Placement, Translation
from .geometry import BuiltGeometry, Part, make_geometry
from .material import bound_material, is_volume_only, read_surface
from .polygons import flat_normals, smooth_normals, triangulate, unit
from .primitives import build_primitive, is_primitive

_PER_POINT = (UsdGeom.Tokens.vertex, UsdGeom.Tokens.varying)


class _BadMeshError(Exception):
    """Why a mesh cannot be shown."""


def read_mesh(prim: Usd.Prim, placement: Placement, context: Context, out: Translation) -> None:
    """Translate a Mesh or an implicit shape into one record per material; a broken one is reported and left out."""
    owner = prim.GetPrimInPrototype() if prim.IsInstanceProxy() else prim
    build = _build_primitive if is_primitive(prim) else _build_mesh
    built = context.geometries.get(owner.GetPath(), context.time, lambda: build(owner, context.time))
    if built.time_varying:
        out.varying = True
    out.notes.extend(replace(n, path=str(prim.GetPath())) for n in built.notes)
    if not np.all(np.isfinite(placement.matrices)):
        out.note("ignored", prim, "its transform is not finite; it is left out")
        return
    determinants = np.linalg.det(placement.matrices[:, :3, :3])
    for part in built.parts:
        path = part.path.ReplacePrefix(owner.GetPath(), prim.GetPath())
        subject = context.stage.GetPrimAtPath(path)
        material = bound_material(subject, out)
        if material is not None and is_volume_only(material):
            out.note("ignored", subject, "a medium in the shape of a mesh is not modelled; it is left out")
            continue
        surface, colors = read_surface(subject, material, context.time, out)
        if surface is None:
            continue
        for mirrored, label in ((False, ""), (True, "[mirrored]" if (determinants >= 0).any() else "")):
            matrices = placement.matrices[(determinants < 0) == mirrored]
            if len(matrices):
                out.meshes.append(
                    Mesh(
                        path=f"{path}{label}",
                        geometry=context.geometries.variant(part.geometry, colors, mirrored),
                        local_to_world=matrices,
                        surface=surface,
                    )
                )
    if built.subdivided:
        out.subdivided = True


def _build_primitive(prim: Usd.Prim, time: Usd.TimeCode) -> BuiltGeometry:
    geometry, varying, problem = build_primitive(prim, time)
    if geometry is None:
        return BuiltGeometry(notes=[Note("ignored", "", problem)], time_varying=varying)
    colors, notes, colors_vary = _colors(prim, time)
    if colors is not None:
        notes.append(Note("approximated", "", "displayColor varies over an implicit shape; its mean is shown"))
        mean = np.broadcast_to(colors[0].mean(axis=0), geometry.points.shape)
        geometry = make_geometry(geometry.points, geometry.normals, geometry.triangles, mean)
    return BuiltGeometry([Part(prim.GetPath(), geometry)], notes, varying or colors_vary)


def _build_mesh(prim: Usd.Prim, time: Usd.TimeCode) -> BuiltGeometry:
    mesh = UsdGeom.Mesh(prim)
    subsets = UsdShade.MaterialBindingAPI(prim).GetMaterialBindSubsets()
    attributes = [
        mesh.GetPointsAttr(),
        mesh.GetFaceVertexCountsAttr(),
        mesh.GetFaceVertexIndicesAttr(),
        mesh.GetHoleIndicesAttr(),
        mesh.GetNormalsAttr(),
        *(s.GetIndicesAttr() for s in subsets),
    ]
    varying = any(a.ValueMightBeTimeVarying() for a in attributes)
    try:
        return _triangles(mesh, subsets, time, varying)
    except _BadMeshError as error:
        return BuiltGeometry(notes=[Note("ignored", "", f"{error}; it is left out")], time_varying=varying)


def _triangles(mesh: UsdGeom.Mesh, subsets: list[UsdGeom.Subset], time: Usd.TimeCode, varying: bool) -> BuiltGeometry:
    points, counts, indices = _topology(mesh, time)
    notes: list[Note] = []
    holes = _array(mesh.GetHoleIndicesAttr().Get(time), np.int64)
    if holes.size and (holes.min() < 0 or holes.max() >= len(counts)):
        notes.append(Note("ignored", "", "holeIndices outside the faces"))
        holes = holes[(holes >= 0) & (holes < len(counts))]
    keep = counts >= 3
    keep[holes] = False
    if not keep.any():
        raise _BadMeshError("has no faces")
    corners, faces = triangulate(points, counts, indices, keep)
    if mesh.GetOrientationAttr().Get() == UsdGeom.Tokens.leftHanded:
        corners = corners[:, ::-1]
    triangles = indices[corners]
    scheme = mesh.GetSubdivisionSchemeAttr().Get()

    normals, normal_ids, normals_vary = _authored_normals(mesh, time, len(points), counts, notes)
    if normals is None and scheme == UsdGeom.Tokens.none:
        normals, normal_ids = flat_normals(points, triangles, faces, len(counts)), "face"
    elif normals is None:
        normals, normal_ids = smooth_normals(points, triangles), "point"
    colors, color_notes, colors_vary = _colors(mesh.GetPrim(), time)
    notes += color_notes
    color_ids = "point"
    if colors is not None:
        colors, color_ids = _per_element(*colors, len(points), counts, "displayColor", notes)

    if normal_ids == "point" and color_ids == "point":
        vertices = (points, normals, colors)
    else:
        # Every corner becomes a vertex of its own.
        ids = {"point": triangles.ravel(), "face": np.repeat(faces, 3), "corner": corners.ravel()}
        vertices = (
            points[ids["point"]],
            normals[ids[normal_ids]],
            None if colors is None else colors[ids[color_ids]],
        )
        triangles = np.arange(triangles.size).reshape(-1, 3)
    parts = _split(mesh, subsets, time, vertices, triangles, faces, len(counts), notes)
    return BuiltGeometry(parts, notes, varying or normals_vary or colors_vary, scheme != UsdGeom.Tokens.none)


def _array(value: object, dtype: type) -> np.ndarray:
    return np.zeros(0, dtype) if value is None else np.asarray(value).astype(dtype)


def _topology(mesh: UsdGeom.Mesh, time: Usd.TimeCode) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Checked (points, counts, indices)."""
    points = _array(mesh.GetPointsAttr().Get(time), np.float64).reshape(-1, 3)
    counts = _array(mesh.GetFaceVertexCountsAttr().Get(time), np.int64)
    indices = _array(mesh.GetFaceVertexIndicesAttr().Get(time), np.int64)
    if not len(points) or not len(counts):
        raise _BadMeshError("has no points or no faces")
    if counts.min() < 0 or counts.sum() != len(indices):
        raise _BadMeshError(
            f"faceVertexCounts asks for {int(counts.sum())} indices and faceVertexIndices has {len(indices)}"
        )
    if len(indices) and (indices.min() < 0 or indices.max() >= len(points)):
        raise _BadMeshError(f"faceVertexIndices points outside its {len(points)} points")
    if not np.all(np.isfinite(points)):
        raise _BadMeshError("has points that are not finite")
    return points, counts, indices


def _authored_normals(
    mesh: UsdGeom.Mesh, time: Usd.TimeCode, n_points: int, counts: np.ndarray, notes: list[Note]
) -> tuple[np.ndarray | None, str, bool]:
    """(unit normals, what they are indexed by, whether they vary in time); primvars:normals come before normals."""
    primvar = UsdGeom.PrimvarsAPI(mesh).GetPrimvar("normals")
    if primvar and primvar.HasAuthoredValue():
        values, interpolation = primvar.ComputeFlattened(time), primvar.GetInterpolation()
        varying = primvar.ValueMightBeTimeVarying()
    else:
        attribute = mesh.GetNormalsAttr()
        values, interpolation = attribute.Get(time), mesh.GetNormalsInterpolation()
        varying = attribute.ValueMightBeTimeVarying()
    if values is None or len(values) == 0:
        return None, "point", varying
    array = _array(values, np.float64).reshape(-1, 3)
    if not np.all(np.isfinite(array)):
        notes.append(Note("ignored", "", "normals that are not finite; they are computed"))
        return None, "point", varying
    normals, ids = _per_element(array, interpolation, n_points, counts, "normals", notes)
    return (None if normals is None else unit(normals)), ids, varying


def _colors(prim: Usd.Prim, time: Usd.TimeCode) -> tuple[tuple[np.ndarray, str] | None, list[Note], bool]:
    """((values, interpolation), notes, whether they vary in time) of a displayColor that is not constant."""
    primvar = UsdGeom.PrimvarsAPI(prim).GetPrimvar("displayColor")
    if not primvar or not primvar.HasAuthoredValue():
        return None, [], False
    varying = primvar.ValueMightBeTimeVarying()
    values = primvar.ComputeFlattened(time)
    interpolation = primvar.GetInterpolation()
    if values is None or len(values) == 0 or interpolation == UsdGeom.Tokens.constant or len(values) == 1:
        return None, [], varying
    array = _array(values, np.float64).reshape(-1, 3)
    if not np.all(np.isfinite(array)):
        return None, [Note("ignored", "", "displayColor that is not finite")], varying
    return (array, interpolation), [], varying


def _per_element(
    values: np.ndarray, interpolation: str, n_points: int, counts: np.ndarray, label: str, notes: list[Note]
) -> tuple[np.ndarray | None, str]:
    """(values, "point" | "face" | "corner"); values whose number does not fit are reported and None."""
    if interpolation == UsdGeom.Tokens.constant:
        return np.broadcast_to(values[0], (n_points, 3)), "point"
    if interpolation in _PER_POINT:
        expected, ids = n_points, "point"
    elif interpolation == UsdGeom.Tokens.uniform:
        expected, ids = len(counts), "face"
    else:
        expected, ids = int(counts.sum()), "corner"
    if len(values) != expected:
        notes.append(
            Note("ignored", "", f"{label}: {len(values)} values, {interpolation} interpolation needs {expected}")
        )
        return None, "point"
    return values, ids


def _split(
    mesh: UsdGeom.Mesh,
    subsets: list[UsdGeom.Subset],
    time: Usd.TimeCode,
    vertices: tuple[np.ndarray, np.ndarray, np.ndarray | None],
    triangles: np.ndarray,
    faces: np.ndarray,
    n_faces: int,
    notes: list[Note],
) -> list[Part]:
    """One part per GeomSubset that may bind a material, and one for the faces in none of them."""
    path = mesh.GetPath()
    if not subsets:
        return [Part(path, make_geometry(vertices[0], vertices[1], triangles, vertices[2]))]
    owner = np.full(n_faces, -1)
    for i, subset in enumerate(subsets):
        if subset.GetElementTypeAttr().Get() != UsdGeom.Tokens.face:
            notes.append(Note("ignored", "", f"the subset {subset.GetPrim().GetName()} is not one of faces"))
            continue
        indices = _array(subset.GetIndicesAttr().Get(time), np.int64)
        legal = indices[(indices >= 0) & (indices < n_faces)]
        if len(legal) != len(indices):
            notes.append(Note("ignored", "", f"faces of the subset {subset.GetPrim().GetName()} that do not exist"))
        owner[legal] = i
    parts = []
    for i in range(-1, len(subsets)):
        chosen = triangles[owner[faces] == i]
        if len(chosen):
            used, compact = np.unique(chosen, return_inverse=True)
            points, normals, colors = (None if a is None else a[used] for a in vertices)
            geometry = make_geometry(points, normals, compact.reshape(-1, 3), colors)
            parts.append(Part(path if i < 0 else subsets[i].GetPath(), geometry))
    return parts
