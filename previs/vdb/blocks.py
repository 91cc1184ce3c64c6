"""Compressed blocks of values, the only place where a file's bytes meet C decompressors.

A block's size is known before it is unpacked (the tree says how many values it holds), so nothing that the block
says of itself is believed: zlib may write so many bytes and no more, and a Blosc header, which ``blosc.decompress``
would trust, is compared with what must stand in it. Not ``blosc2``: it refuses the split streams of Blosc 1 in which
one part is stored raw, which real files hold.
"""

from __future__ import annotations

import functools
import struct
import zlib
from collections.abc import Callable

from .layout import COMPRESS_BLOSC, COMPRESS_ZIP

_unpack_size = struct.Struct("<q").unpack_from
_unpack_blosc = struct.Struct("<BBBBIII").unpack_from
_BLOSC_HEADER = 16
_BLOSC_STORED = 0x2


def read_block(data: memoryview, position: int, size: int, flags: int) -> tuple[bytes | memoryview, int]:
    """The ``size`` bytes of the block at ``position``, and the position after it. ValueError if it cannot be."""
    start, length = find_block(data, position, size, flags)
    after = start + abs(length)
    block = data[start:after]
    if length <= 0 or not size:
        return (block if size else b""), after
    if flags & COMPRESS_BLOSC:
        return _unblosc(block, size), after
    if flags & COMPRESS_ZIP:
        return _unzip(block, size), after
    return block, after


def find_block(data: memoryview, position: int, size: int, flags: int) -> tuple[int, int]:
    """Where a block of ``size`` bytes starts and how long it is in the file; a length ≤ 0 means stored raw."""
    if not flags & (COMPRESS_BLOSC | COMPRESS_ZIP):
        start, length = position, size
    else:
        (length,) = _unpack_size(data, position)
        start = position + 8
        if length <= 0 and -length != size:
            raise ValueError(f"a block of {size} bytes is stored raw in {-length} bytes")
    if start + abs(length) > len(data):
        raise ValueError(f"a block of {abs(length)} bytes reaches beyond the data")
    return start, length


def _unzip(block: memoryview, size: int) -> bytes:
    try:
        values = zlib.decompressobj().decompress(block, size + 1)
    except zlib.error as error:
        raise ValueError(f"a zip block cannot be unpacked ({error})") from None
    if len(values) != size:
        raise ValueError(f"a zip block does not unpack to {size} bytes")
    return values


@functools.cache
def _blosc() -> tuple[Callable[[memoryview], bytes], type[Exception]]:
    """The decompressor and its error, loaded when a file asks for them: their package brings its own tests along."""
    import blosc
    from blosc.blosc_extension import error

    return blosc.decompress, error


def _unblosc(block: memoryview, size: int) -> bytes:
    if len(block) < _BLOSC_HEADER:
        raise ValueError("a Blosc block is shorter than its header")
    _, _, blosc_flags, type_size, full, per_block, packed = _unpack_blosc(block)
    if full != size or packed != len(block) or not type_size or not 0 < per_block <= full:
        raise ValueError(f"the header of a Blosc block of {len(block)} bytes does not promise {size} bytes")
    needed = full if blosc_flags & _BLOSC_STORED else 4 * -(-full // per_block)
    if len(block) < _BLOSC_HEADER + needed:
        raise ValueError("a Blosc block is shorter than its header says")
    decompress, BloscError = _blosc()
    try:
        values = decompress(block)
    except BloscError as error:
        raise ValueError(f"a Blosc block cannot be unpacked ({error})") from None
    if len(values) != size:
        raise ValueError(f"a Blosc block does not unpack to {size} bytes")
    return values
