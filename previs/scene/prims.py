"""Finding the prim behind a path that a user or a record names."""

from __future__ import annotations

from pxr import Sdf, Usd, UsdGeom, UsdVol

from ..errors import PrevisError
from ..stage.context import Translation
from ..stage.material import bound_material, is_volume_only


def plain_path(path: str) -> str:
    """The path of the prim behind that of a record.

    ``/smoke[3]``, a place inside a PointInstancer, is ``/smoke``; ``/crowd</smoke>[3]``, a prototype that several
    instancers share, is ``/smoke``.
    """
    plain = str(path).split("[", 1)[0]
    if plain.endswith(">"):
        plain = plain[plain.index("<") + 1 : -1] if "<" in plain else plain
    return plain


def find_prim(stage: Usd.Stage, path: str) -> Usd.Prim | None:
    """The prim at a path or at that of a record, None where there is none; of a GeomSubset the mesh it is a part of."""
    plain = plain_path(path)
    valid = Sdf.Path.IsValidPathString(plain) and Sdf.Path(plain).IsAbsoluteRootOrPrimPath()
    prim = stage.GetPrimAtPath(plain) if valid else None
    if not prim or prim.IsPseudoRoot():
        return None
    return prim.GetParent() if prim.IsA(UsdGeom.Subset) else prim


def existing_prim(stage: Usd.Stage, path: str, what: str) -> Usd.Prim:
    """The prim at a path. Raises `PrevisError`, which says that there is no such `what`."""
    prim = find_prim(stage, path)
    if prim is None:
        raise PrevisError(f"{path}: no such {what} in the scene")
    return prim


def editable_prim(stage: Usd.Stage, path: str, what: str) -> Usd.Prim:
    """The prim at a path, for an edit. Raises `PrevisError` where there is none, or where instances share it."""
    prim = existing_prim(stage, path, what)
    if prim.IsInstanceProxy():
        raise PrevisError(f"{path}: belongs to a native instance, which cannot be edited on its own")
    return prim


def is_volume(prim: Usd.Prim) -> bool:
    """Whether a prim is a Volume, or a shape whose material makes it a medium."""
    if prim.IsA(UsdVol.Volume):
        return True
    material = bound_material(prim, Translation(prim.GetPath())) if prim.IsA(UsdGeom.Gprim) else None
    return material is not None and is_volume_only(material)


def require_volume(prim: Usd.Prim) -> Usd.Prim:
    """The prim. Raises `PrevisError` when it has no medium."""
    if not is_volume(prim):
        raise PrevisError(f"{prim.GetPath()}: is neither a Volume nor a shape with a medium")
    return prim
