"""Texts that are written for other programs: a file of ``texts`` each, filled in by jinja2."""

from __future__ import annotations

from pathlib import Path
from typing import Any


def filled(name: str, /, **values: Any) -> str:
    """A text with its values.

    Parameters
    ----------
    name : str
        A file of ``texts``. Its filter ``nine`` writes a number to nine significant digits.
    **values
        What it calls by name.
    """
    from jinja2 import Environment

    maker = Environment(trim_blocks=True, keep_trailing_newline=True)
    maker.filters["nine"] = "{:.9g}".format
    return maker.from_string((Path(__file__).parent / "texts" / name).read_text(encoding="utf-8")).render(values)
