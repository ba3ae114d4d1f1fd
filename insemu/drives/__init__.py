"""What recorded and emulated vehicles do: a drive in bands and regimes, two drives held against each other."""

import sys

from insemu import CalledRoom
from insemu.drives.compared import ALIKE_DB, Band, Comparison, Telling, compare_drives
from insemu.drives.windows import REGIMES, Windows, signals_of, top_of, windows_of

__all__ = [
    "ALIKE_DB",
    "REGIMES",
    "Band",
    "Comparison",
    "Telling",
    "Windows",
    "compare_drives",
    "signals_of",
    "top_of",
    "windows_of",
]

sys.modules[__name__].__class__ = CalledRoom
