"""What was recorded: logs at rest reduced to statistics, what the samples show by themselves, files."""

from insemu.gap.data.log import Reduced, block_differences, block_length, spectrum_bins
from insemu.gap.data.samples import louder
from insemu.gap.data.sources import StaticLog, at_rest, recorded_temperature, static_of

__all__ = [
    "Reduced",
    "StaticLog",
    "at_rest",
    "block_differences",
    "block_length",
    "louder",
    "recorded_temperature",
    "spectrum_bins",
    "static_of",
]
