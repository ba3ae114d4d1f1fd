"""From the bench to the road: by what factors the noise of a drive exceeds that of the static log, and why."""

from insemu.transfer.judged import Judged, fitted, judge
from insemu.transfer.levels import Constant, Estimate, Factor, Levels, estimated
from insemu.transfer.session import CONSTANTS, Share, Transfer, levels_of, transfer

__all__ = [
    "CONSTANTS",
    "Constant",
    "Estimate",
    "Factor",
    "Judged",
    "Levels",
    "Share",
    "Transfer",
    "estimated",
    "fitted",
    "judge",
    "levels_of",
    "transfer",
]
