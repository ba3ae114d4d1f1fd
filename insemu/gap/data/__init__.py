"""What was recorded: logs at rest reduced to statistics, what the samples show by themselves, files."""
