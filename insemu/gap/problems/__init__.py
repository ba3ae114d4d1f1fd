"""The two problems that are searched: a log at rest, and a drive or flight."""

from insemu.gap.problems.known_effects import drive_without

__all__ = ["drive_without"]
