"""The edits of a stage: what one layer holds besides what it is composed over.

Edits of an opened scene are the session layer's own content; layers that the scene was opened with lie below it and
are no edits. A scene that was built has no edits apart from itself: its root layer is what undo puts back.
"""

from __future__ import annotations

from pxr import Sdf, Tf, Usd

from ..errors import PrevisError
from ..stage.diagnostics import one_line, quiet_diagnostics

_BELOW = ("subLayers", "subLayerOffsets")


class Edits:
    """The edits of one stage, as text and as a whole. `opened` says that they are on the session layer."""

    def __init__(self, stage: Usd.Stage, opened: bool) -> None:
        self.opened = opened
        self.layer = stage.GetSessionLayer() if opened else stage.GetRootLayer()
        self._stage = stage
        self._without: Usd.Stage | None = None

    def snapshot(self) -> str:
        """The edits as .usda text."""
        copy = Sdf.Layer.CreateAnonymous(".usda")
        copy.TransferContent(self.layer)
        if self.opened:
            copy.subLayerPaths.clear()
        return copy.ExportToString()

    def restore(self, snapshot: str) -> None:
        """Put other edits in the place of these. Raises `PrevisError` when the text is no .usda."""
        copy = Sdf.Layer.CreateAnonymous(".usda")
        try:
            with quiet_diagnostics():
                copy.ImportFromString(snapshot)
        except Tf.ErrorException as error:
            raise PrevisError(f"these edits cannot be read as USD: {one_line(error)}") from error
        self.replace(copy)

    def replace(self, edits: Sdf.Layer) -> None:
        """Take over the content of a layer, which is changed to have the same layers below it."""
        if self.opened:
            edits.subLayerPaths = list(self.layer.subLayerPaths)
            for i, offset in enumerate(self.layer.subLayerOffsets):
                edits.subLayerOffsets[i] = offset
        # Only what differs is changed and announced.
        self.layer.TransferContent(edits)

    @property
    def empty(self) -> bool:
        """Whether nothing is edited."""
        own = set(self.layer.pseudoRoot.ListInfoKeys()).difference(_BELOW)
        return not own and not self.layer.rootPrims

    def discard(self) -> None:
        """Take all edits back."""
        self.replace(Sdf.Layer.CreateAnonymous(".usda"))

    def prune(self) -> None:
        """Remove what says nothing any more after something was removed."""
        if self.opened:
            self.layer.RemoveInertSceneDescription()

    @property
    def stage_without(self) -> Usd.Stage:
        """A stage of the same layers without the edits; that of a built scene is the stage itself."""
        if not self.opened:
            return self._stage
        if self._without is None:
            session = Sdf.Layer.CreateAnonymous("session.usda")
            session.subLayerPaths = list(self.layer.subLayerPaths)
            root, mask = self._stage.GetRootLayer(), self._stage.GetPopulationMask()
            with quiet_diagnostics():
                self._without = Usd.Stage.OpenMasked(root, session, mask)
        return self._without

    def close(self) -> None:
        """Release the stage without the edits."""
        self._without = None
