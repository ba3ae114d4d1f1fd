"""A drive or flight prepared for the search: the run of the nominal filter, signatures of effects, and their responses."""

from insemu.gap.drive.preparation import Flown, Prepared, for_filter, starting_state, with_sigma

__all__ = ["Flown", "Prepared", "for_filter", "starting_state", "with_sigma"]
