"""Compiled kernels are cached on disk; this keeps a cached kernel from outliving the kernels that it calls.

numba renews a cached function when the file that defines it changes, but not when a function that was inlined into it changes in another
file: after a pull the filter would go on with the old mechanization inside. When any file with kernels changes, all of them are
compiled anew.
"""

from __future__ import annotations

import hashlib
from contextlib import suppress
from pathlib import Path


def forget_stale_kernels(root: Path) -> bool:
    """Delete the compiled kernels under a package folder if the sources of any kernel changed since the last call.

    Parameters
    ----------
    root : Path
        Folder of the package.

    Returns
    -------
    bool
        Whether the sources had changed.
    """
    stamp = root / "__pycache__" / "kernels.stamp"
    sources = sorted(root.rglob("*.py"))
    looks = hashlib.sha256("".join(f"{p}{p.stat().st_mtime_ns}" for p in sources).encode()).hexdigest()
    try:
        known_looks, known_content = stamp.read_text(encoding="ascii").split()
    except (OSError, ValueError):
        known_looks = known_content = ""
    if looks == known_looks:
        return False
    texts = [p.read_bytes() for p in sources]
    content = hashlib.sha256(b"".join(t for t in texts if b"njit" in t)).hexdigest()
    changed = content != known_content
    with suppress(OSError):  # a package folder that cannot be written holds no cache either
        if changed:
            for cached in root.rglob("*.nb[ic]"):
                cached.unlink(missing_ok=True)
        stamp.parent.mkdir(exist_ok=True)
        stamp.write_text(f"{looks} {content}", encoding="ascii")
    return changed
