"""What is believed: the nominal model that goes in and the refined one that comes out."""

from insemu.gap.beliefs.refined import filter_noise

__all__ = ["filter_noise"]
