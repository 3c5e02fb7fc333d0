"""Tracklets nobody knows, brought together over days: one arc's orbit -> boundary value between two -> growth -> batch judge."""
