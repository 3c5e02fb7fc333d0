"""Peers of the benchmark: programs that run in an environment of their own, and how to make it."""
