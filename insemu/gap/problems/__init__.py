"""The two problems that are searched: a log at rest, and a drive or flight."""
