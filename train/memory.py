"""How the C library gives memory back: PyTorch on a CPU asks for the same large pieces in every step."""

from __future__ import annotations

import ctypes
import sys

# Names and numbers of glibc's malloc.h.
_TRIM_THRESHOLD, _TOP_PAD, _MMAP_THRESHOLD = -1, -2, -3
_LARGEST_MMAP_THRESHOLD = 32 * 2**20
"""The greatest that glibc takes."""


def reuse_freed_memory() -> bool:
    """Has freed memory kept for the next step instead of returned to the system, which would clear it page by page.

    Makes a training step of a nano network 5 % faster. The process keeps what it took at its peak until it ends.

    Returns:
        Whether the C library knows of such things; glibc does.
    """
    if not sys.platform.startswith("linux"):
        return False
    library = ctypes.CDLL(None)
    if not hasattr(library, "mallopt"):
        return False
    values = ((_MMAP_THRESHOLD, _LARGEST_MMAP_THRESHOLD), (_TRIM_THRESHOLD, 2**31 - 1), (_TOP_PAD, 2**28))
    return all(library.mallopt(name, value) == 1 for name, value in values)
