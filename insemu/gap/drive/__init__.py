"""A drive or flight prepared for the search: the run of the nominal filter, signatures of effects, and their responses."""
