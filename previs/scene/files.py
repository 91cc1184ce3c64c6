"""Reading again what changed on disk, and layers of overrides from and to files."""

from __future__ import annotations

import os
from pathlib import Path

from pxr import Sdf, Tf, Usd, UsdUtils

from ..errors import PrevisError
from ..stage.diagnostics import one_line, quiet_diagnostics
from ..stage.field import outer_file
from ..stage.opening import open_layer


def reload_layers(stage: Usd.Stage) -> None:
    """Read the layers again whose files changed, and those that were missing and are there now.

    Raises `PrevisError`, which names a file that cannot be read; what was read of it before stays, and the others are
    read all the same.
    """
    failures = []
    for layer in stage.GetUsedLayers():
        # Reading one again may have dropped others. One that somebody changed in memory keeps that.
        if not layer or layer.anonymous or layer.dirty:
            continue
        if not os.path.exists(outer_file(layer.realPath)):
            failures.append(f"{layer.realPath}: is gone; what was read of it stays")
            continue
        try:
            with quiet_diagnostics():
                layer.Reload()
        except Tf.ErrorException as error:
            failures.append(f"{layer.realPath}: cannot be read as USD: {one_line(error)}")
    # Reloading the stage looks for layers that were missing, and would empty those that are in memory only.
    below_session = stage.GetLayerStack(includeSessionLayers=False)
    if not failures and not any(layer.anonymous for layer in below_session):
        try:
            with quiet_diagnostics():
                stage.Reload()
        except Tf.ErrorException as error:
            failures.append(f"{stage.GetRootLayer().realPath}: cannot be read again: {one_line(error)}")
    if failures:
        raise PrevisError(failures[0])


def missing_layers(stage: Usd.Stage) -> tuple[str, ...]:
    """The files that layers of a stage name and that do not exist."""
    found: dict[str, None] = {}
    for layer in stage.GetUsedLayers():
        for dependency in layer.GetCompositionAssetDependencies():
            path = Sdf.ComputeAssetPathRelativeToLayer(layer, dependency)
            anonymous = Sdf.Layer.IsAnonymousLayerIdentifier(path)
            if path and not anonymous and not os.path.exists(path) and os.path.isabs(path):
                found[path] = None
    return tuple(found)


def read_overrides(path: str | os.PathLike[str]) -> Sdf.Layer:
    """What a file of overrides and its sublayers hold, as one layer in memory with absolute asset paths.

    Raises `PrevisError` for a file that is missing or no USD.
    """
    with quiet_diagnostics():
        layer = open_layer(os.fspath(path))
        try:
            return UsdUtils.FlattenLayerStack(Usd.Stage.Open(layer, load=Usd.Stage.LoadNone))
        except Tf.ErrorException as error:
            raise PrevisError(f"{path}: cannot be read as USD: {one_line(error)}") from error


def overrides_for(stage: Usd.Stage, path: Path) -> Sdf.Layer:
    """What a file of overrides of an opened stage is to hold: its session layers as one layer.

    A file that is a sublayer of the stage keeps what it holds, under the overrides. Raises `PrevisError` for one that
    the stage uses in another way.
    """
    session = Usd.Stage.Open(stage.GetSessionLayer(), load=Usd.Stage.LoadNone)
    overrides = UsdUtils.FlattenLayerStack(session)
    target = os.path.realpath(path)
    used = next((layer for layer in stage.GetUsedLayers() if os.path.realpath(layer.realPath or "/") == target), None)
    if used is None or used in session.GetLayerStack():
        return overrides
    if used == stage.GetRootLayer():
        raise PrevisError(f"{path}: is the opened stage itself; overrides go to a file of their own")
    if used not in stage.GetLayerStack(includeSessionLayers=False):
        raise PrevisError(f"{path}: is a file that the stage refers to; overrides go to a file of their own")
    held = Sdf.Layer.CreateAnonymous(".usda")
    held.TransferContent(used)
    UsdUtils.ModifyAssetPaths(held, lambda name: Sdf.ComputeAssetPathRelativeToLayer(used, name))
    below, offsets = list(held.subLayerPaths), list(held.subLayerOffsets)
    held.subLayerPaths.clear()
    both = Sdf.Layer.CreateAnonymous(".usda")
    both.subLayerPaths = [overrides.identifier, held.identifier]
    merged = UsdUtils.FlattenLayerStack(Usd.Stage.Open(both, load=Usd.Stage.LoadNone))
    merged.subLayerPaths = below
    for i, offset in enumerate(offsets):
        merged.subLayerOffsets[i] = offset
    return merged
