"""Nats of log evidence: explanations of a log at rest, linear models of innovations, noise of the fixes."""
