"""A drive or flight prepared for the search: the run of the nominal filter, signatures of effects, and their responses."""

from insemu.gap.drive.fix_outliers import FIRST, by_filter, known_outliers, outlying, without
from insemu.gap.drive.preparation import Flown, Prepared, for_filter, starting_state, with_sigma

__all__ = [
    "FIRST",
    "Flown",
    "Prepared",
    "by_filter",
    "for_filter",
    "known_outliers",
    "outlying",
    "starting_state",
    "with_sigma",
    "without",
]
