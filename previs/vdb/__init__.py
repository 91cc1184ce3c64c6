"""OpenVDB files in NumPy: sparse grids read from and written to .vdb.

>>> from previs import vdb
>>> vdb.write("ball.vdb", [vdb.Grid.from_dense("density", array, index_to_world)])
>>> [density] = vdb.read("ball.vdb", names=["density"])
>>> density.dense(*density.bounds)
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from .grid import DENSE_LIMIT, Grid, Tiles
from .reader import GridInfo, read, read_metadata

if TYPE_CHECKING:
    from .writer import write

__all__ = ["DENSE_LIMIT", "Grid", "GridInfo", "Tiles", "read", "read_metadata", "write"]


def __getattr__(name: str) -> Any:
    # Who reads a file need not load what writes one.
    if name != "write":
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from .writer import write

    globals()["write"] = write
    return write
