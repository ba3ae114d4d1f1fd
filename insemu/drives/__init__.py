"""What recorded and emulated vehicles do: a drive in bands and regimes, two drives held against each other."""

from insemu.drives.compared import ALIKE_DB, Band, Comparison, Telling, compare_drives, unit_of
from insemu.drives.learned import LearnedVehicle, learn_vehicle, track_for
from insemu.drives.sideslip import Sideslip
from insemu.drives.windows import REGIMES, Windows, signals_of, top_of, windows_of, within

__all__ = [
    "ALIKE_DB",
    "REGIMES",
    "Band",
    "Comparison",
    "LearnedVehicle",
    "Sideslip",
    "Telling",
    "Windows",
    "compare_drives",
    "learn_vehicle",
    "signals_of",
    "top_of",
    "track_for",
    "unit_of",
    "windows_of",
    "within",
]
