"""PointInstancers: every prim of a prototype, at every place of its instances."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from pxr import Gf, Sdf, Usd, UsdGeom

from .context import Context, Placement, Translation
from .values import numpy_matrix

Translate = Callable[[Usd.Prim, Placement, Context, Translation], None]

# A prototype root may be an `over`, whose children are not "defined" in USD's sense.
_PROTOTYPE_PRIMS = Usd.PrimIsActive & Usd.PrimIsLoaded & Usd.PrimHasDefiningSpecifier
_LIMIT = 64


def read_point_instancer(
    prim: Usd.Prim, placement: Placement, context: Context, out: Translation, translate: Translate
) -> None:
    """Hand every prim of every prototype to `translate`, placed at all instances that are neither masked nor invisible.

    The prototype's own transform applies, the transforms above it do not; its visibility counts from the prototype's
    root downwards.
    """
    instancer = UsdGeom.PointInstancer(prim)
    time = context.time
    indices = instancer.GetProtoIndicesAttr().Get(time)
    targets = instancer.GetPrototypesRel().GetForwardedTargets()
    if indices is None or len(indices) == 0 or not targets:
        out.note("empty", prim, "has no instances or no prototypes")
        return
    if placement.indices.shape[1] >= _LIMIT:
        out.note("ignored", prim, "instances itself; it is left out")
        return
    indices = np.asarray(indices)
    mask = np.array(instancer.ComputeMaskAtTime(time), bool)
    if mask.size == 0:
        mask = np.ones(len(indices), bool)
    positions = instancer.GetPositionsAttr().Get(time)
    if positions is None or len(positions) != len(indices) or len(mask) != len(indices):
        out.note("ignored", prim, f"{len(indices)} protoIndices and {len(positions or ())} positions; it is left out")
        return
    transforms = instancer.ComputeInstanceTransformsAtTime(
        time,
        time,
        UsdGeom.PointInstancer.IncludeProtoXform,
        UsdGeom.PointInstancer.IgnoreMask,
    )
    if transforms is None or len(transforms) != len(indices):
        out.note("ignored", prim, "its instance transforms cannot be computed; it is left out")
        return
    transforms = np.asarray(transforms, float).reshape(-1, 4, 4)
    if indices.min() < 0 or indices.max() >= len(targets):
        out.note("ignored", prim, f"protoIndices outside its {len(targets)} prototypes")
    for p, target in enumerate(targets):
        chosen = np.flatnonzero((indices == p) & mask)
        if len(chosen) == 0:
            continue
        root = context.stage.GetPrimAtPath(target)
        if not root:
            out.note("missing", prim, f"its prototype {target} does not exist")
            continue
        if target == prim.GetPath() or prim.GetPath().HasPrefix(target):
            out.note("ignored", prim, f"its prototype {target} holds the instancer itself")
            continue
        # Every place of the instancer times every instance: (K·M, 4, 4).
        matrices = np.einsum("mij,kjl->kmil", transforms[chosen], placement.matrices).reshape(-1, 4, 4)
        labels = np.concatenate(
            [
                np.repeat(placement.indices, len(chosen), axis=0),
                np.tile(chosen, len(placement.matrices))[:, None],
            ],
            axis=1,
        )
        _read_prototype(root, Placement(matrices, labels, prim.GetPath()), context, out, translate)


def _read_prototype(
    root: Usd.Prim, placement: Placement, context: Context, out: Translation, translate: Translate
) -> None:
    walk = iter(Usd.PrimRange(root, Usd.TraverseInstanceProxies(_PROTOTYPE_PRIMS)))
    for prim in walk:
        out.depend(prim)
        if _hidden(prim, context.time):
            walk.PruneChildren()
            continue
        if not is_visible_purpose(prim, context):
            continue
        if prim.IsA(UsdGeom.PointInstancer):
            walk.PruneChildren()
        relative = _relative_transform(prim, root, context)
        translate(prim, Placement(relative @ placement.matrices, placement.indices, placement.instancer), context, out)


def _relative_transform(prim: Usd.Prim, root: Usd.Prim, context: Context) -> np.ndarray:
    matrix = Gf.Matrix4d(1.0)
    if prim != root:
        matrix, _ = context.xforms.ComputeRelativeTransform(prim, root)
    return numpy_matrix(matrix)


def _hidden(prim: Usd.Prim, time: Usd.TimeCode) -> bool:
    attribute = UsdGeom.Imageable(prim).GetVisibilityAttr() if prim.IsA(UsdGeom.Imageable) else None
    return bool(attribute) and attribute.Get(time) == UsdGeom.Tokens.invisible


def is_visible_purpose(prim: Usd.Prim, context: Context) -> bool:
    """Whether the prim's computed purpose is one of those asked for."""
    imageable = UsdGeom.Imageable(prim)
    return not imageable or imageable.ComputePurpose() in context.purposes


def prototype_path(path: Sdf.Path, instancer: Sdf.Path) -> str:
    """The name of a prototype's prim under one of several instancers that share it: ``/Instancer</Prototype/prim>``."""
    return f"{instancer}<{path}>"
