"""OpenVDB files in NumPy: sparse grids read from and written to .vdb.

>>> from previs import vdb
>>> vdb.write("ball.vdb", [vdb.Grid.from_dense("density", array, index_to_world)])
>>> [density] = vdb.read("ball.vdb", names=["density"])
>>> density.dense(*density.bounds)
"""

from .grid import DENSE_LIMIT, Grid, Tiles
from .reader import GridInfo, read, read_metadata
from .writer import write

__all__ = ["DENSE_LIMIT", "Grid", "GridInfo", "Tiles", "read", "read_metadata", "write"]
