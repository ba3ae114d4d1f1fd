"""Where a model and a recording disagree, in calibrated p-values."""
