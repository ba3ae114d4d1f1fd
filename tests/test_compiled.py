"""A cached kernel does not outlive the kernels that it calls."""

from __future__ import annotations

import os
from pathlib import Path

from insemu.compiled import forget_stale_kernels


def test_kernels_go_when_a_kernel_source_changes_and_stay_otherwise(tmp_path: Path) -> None:
    (tmp_path / "__pycache__").mkdir()
    kernel, plain, cached = (
        tmp_path / "kernel.py",
        tmp_path / "plain.py",
        tmp_path / "__pycache__" / "kernel.f-1.py311.1.nbc",
    )
    kernel.write_text("@njit\ndef f(): return 1\n")
    plain.write_text("x = 1\n")
    assert forget_stale_kernels(tmp_path)
    cached.write_bytes(b"compiled")
    assert not forget_stale_kernels(tmp_path)
    plain.write_text("x = 2\n")
    os.utime(kernel, ns=(1, 1))  # touched, not changed
    assert not forget_stale_kernels(tmp_path)
    assert cached.exists()
    kernel.write_text("@njit\ndef f(): return 2\n")
    assert forget_stale_kernels(tmp_path)
    assert not cached.exists()
