"""Columns as commands take them."""

from __future__ import annotations

from collections.abc import Sequence


def column_names(texts: Sequence[str] | None) -> list[str] | None:
    """Names of ``-c gx,gy -c gz`` one by one; None where no column is asked for."""
    return [name.strip() for text in texts or [] for name in text.split(",") if name.strip()] or None
