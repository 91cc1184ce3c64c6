"""What may differ from one time to another."""

from __future__ import annotations

from pxr import Sdf, Usd, UsdGeom

from .context import Translation


class Variation:
    """Tells which translations may differ at another time, for a stage that does not change meanwhile.

    Whatever is not certain counts as varying. The default time is not a time among others: values without variation
    may still be others there.
    """

    def __init__(self, stage: Usd.Stage) -> None:
        self._stage = stage
        self._known: dict[Sdf.Path, bool] = {Sdf.Path.absoluteRootPath: False}

    def varies(self, out: Translation) -> bool:
        """Whether a prim that the translation depends on, or one above such a prim, may vary."""
        if out.varying is None:
            out.varying = any(self._prim_varies(path) for path in out.dependencies)
        return out.varying

    def _prim_varies(self, path: Sdf.Path) -> bool:
        known = self._known.get(path)
        if known is None:
            known = self._known[path] = self._prim_varies(path.GetParentPath()) or _has_animation(
                self._stage.GetPrimAtPath(path)
            )
        return known


def _has_animation(prim: Usd.Prim) -> bool:
    # Value clips may animate what no layer of the stage mentions, on the prim and everything below it.
    if prim.HasAuthoredMetadata("clips"):
        return True
    attributes = prim.GetAuthoredAttributes()
    if prim.IsA(UsdGeom.PointInstancer):
        # Velocities carry instances away from a single sample.
        return any(a.GetNumTimeSamples() > 0 for a in attributes)
    return any(a.ValueMightBeTimeVarying() for a in attributes)
