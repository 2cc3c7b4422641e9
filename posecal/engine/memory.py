"""Memory of the arrays of blocks, which one block after another takes."""

from __future__ import annotations

from functools import cache

import numpy as np


@cache
def reuse_freed_memory() -> None:
    """Let the memory of one block's arrays be that of the next one's.

    glibc returns freed arrays of more than 128 KiB to the system, which has to clear every page again for the next:
    half of the time of a walk. It keeps them once a larger array was freed, of up to 32 MiB (``man mallopt``,
    M_MMAP_THRESHOLD); this one is never written to. Elsewhere nothing happens.
    """
    np.empty(31 * 1024 * 1024, dtype=np.uint8)
