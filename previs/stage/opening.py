"""Opening a stage, with one clear line for whatever is wrong with the file."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping
from pathlib import Path

from pxr import Ar, Sdf, Tf, Usd

from ..errors import PrevisError
from .diagnostics import one_line, quiet_diagnostics
from .render_settings import KNOBS_PATH

FilePath = str | os.PathLike[str]


def open_stage(
    path: FilePath,
    session_layer: FilePath | None = None,
    mask: Iterable[str] | str | None = None,
    variants: Mapping[str, Mapping[str, str]] | None = None,
    root: Sdf.Layer | None = None,
) -> Usd.Stage:
    """Open a .usd, .usda, .usdc or .usdz file with all payloads.

    `session_layer` is a layer file composed over the stage. Edits never change that file: they go to an anonymous
    layer above it. `mask` limits the stage to these prim paths, what they bind or connect to, and the render settings.
    `variants` maps prim paths to {variant set: variant}; the choice is authored on a layer below the session layer.
    `root` is a layer to open instead of the file, which then only has its name in messages.

    Raises `PrevisError`, one line that names the file or prim, when the file is missing, is no stage or is damaged, or
    when a mask path, prim or variant does not exist.
    """
    name = os.fspath(path)
    with quiet_diagnostics():
        if root is None:
            root = open_layer(name)
        session = Sdf.Layer.CreateAnonymous("session.usda")
        if session_layer is not None:
            layer = open_layer(os.fspath(session_layer))
            # The session layer is in no folder, so a relative path would mean another file later.
            session.subLayerPaths.append(layer.realPath or layer.identifier)
        paths = [mask] if isinstance(mask, str) else list(mask or ())
        try:
            if paths:
                settings = [str(KNOBS_PATH), str(root.pseudoRoot.GetInfo("renderSettingsPrimPath") or KNOBS_PATH)]
                stage = Usd.Stage.OpenMasked(root, session, _population_mask([*paths, *settings]))
                stage.ExpandPopulationMask()
            else:
                stage = Usd.Stage.Open(root, session)
        except Tf.ErrorException as error:
            raise PrevisError(f"{name}: cannot open the stage: {one_line(error)}") from error
        for masked in paths:
            if not stage.GetPrimAtPath(masked):
                raise PrevisError(f"{name}: no prim at {masked}, which the mask asks for")
        if variants:
            # On a layer of their own, above the user's and below the edits: a choice made here is no edit.
            choices = Sdf.Layer.CreateAnonymous("variants.usda")
            session.subLayerPaths.insert(0, choices.identifier)
            with Usd.EditContext(stage, choices):
                for prim_path, selections in variants.items():
                    _select_variants(stage, name, prim_path, selections)
    return stage


def open_layer(name: str) -> Sdf.Layer:
    """The layer in a file. Raises `PrevisError`, one line that names it, when it is missing, no USD or damaged."""
    if os.path.isdir(name):
        raise PrevisError(f"{name}: is a folder, not a USD file")
    resolved = Ar.GetResolver().Resolve(name)
    if not resolved:
        raise PrevisError(f"{name}: no such file")
    if not Sdf.FileFormat.FindByExtension(Ar.GetResolver().GetExtension(name)):
        ending = Path(name).suffix or "no ending"
        raise PrevisError(f"{name}: not a USD file ({ending}); expected .usd, .usda, .usdc or .usdz")
    try:
        # By its absolute path: what it says must not depend on the working folder of later.
        layer = Sdf.Layer.FindOrOpen(resolved.GetPathString())
    except Tf.ErrorException as error:
        raise PrevisError(f"{name}: cannot be read as USD: {one_line(error)}") from error
    if layer is None:
        raise PrevisError(f"{name}: cannot be read as USD")
    return layer


def _population_mask(paths: list[str]) -> Usd.StagePopulationMask:
    for path in paths:
        if not Sdf.Path.IsValidPathString(path) or not Sdf.Path(path).IsAbsoluteRootOrPrimPath():
            raise PrevisError(f"{path}: not a prim path (expected /Prim/Child)")
    return Usd.StagePopulationMask(paths)


def _select_variants(stage: Usd.Stage, name: str, prim_path: str, selections: Mapping[str, str]) -> None:
    prim = stage.GetPrimAtPath(prim_path) if Sdf.Path.IsValidPathString(prim_path) else None
    if not prim:
        raise PrevisError(f"{name}: no prim at {prim_path} to choose a variant of")
    for set_name, variant in selections.items():
        variant_set = prim.GetVariantSets().GetVariantSet(set_name)
        names = variant_set.GetVariantNames() if prim.GetVariantSets().HasVariantSet(set_name) else []
        if variant not in names:
            known = ", ".join(names) or "none"
            raise PrevisError(f"{prim_path}: no variant {set_name}={variant} (there are: {known})")
        variant_set.SetVariantSelection(variant)
