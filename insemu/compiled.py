"""Compiled kernels are cached on disk: none outlives the kernels that it calls, and the largest are compiled by a process of their own.

numba renews a cached function when the file that defines it changes, but not when a function that was inlined into it changes in another
file: after a pull the filter would go on with the old mechanization inside. When any file with kernels changes, all of them are
compiled anew.
"""

from __future__ import annotations

import hashlib
import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
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


_beside: subprocess.Popen[str] | None = None


@contextmanager
def compiled_beside(program: str, kernel: str) -> Iterator[None]:
    """Let another process compile kernels while this one does something else, where they have not been compiled yet.

    Parameters
    ----------
    program : str
        Module that calls them, for ``python -m``; it prints a line as soon as ``kernel`` is there and may go on to others.
    kernel : str
        Module and function, for example ``insemu.filters.kernel.run``: whether it is kept tells whether the program is needed.
    """
    global _beside
    module, _, function = kernel.rpartition(".")
    package = Path(__file__).parent.parent
    source = package.joinpath(*module.split(".")).with_suffix(".py")
    kept = source.parent / "__pycache__"
    known = any(kept.glob(f"{source.stem}.{function}-*.nbi"))
    if known or "NUMBA_CACHE_DIR" in os.environ or not os.access(kept if kept.exists() else source.parent, os.W_OK):
        yield
        return
    path = os.pathsep.join([str(package), *filter(None, [os.environ.get("PYTHONPATH")])])
    nothing = subprocess.DEVNULL
    with subprocess.Popen(
        [sys.executable, "-m", program],
        stdin=nothing,
        stdout=subprocess.PIPE,
        stderr=nothing,
        text=True,
        env=os.environ | {"PYTHONPATH": path},
    ) as _beside:
        try:
            yield
        finally:
            _beside.kill()
            _beside = None


def wait_for_kernels() -> None:
    """Wait until a process of :func:`compiled_beside` has the kernel that it was started for; where it failed, this one compiles it."""
    if _beside is not None and _beside.stdout is not None:
        _beside.stdout.readline()
