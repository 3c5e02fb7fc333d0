"""Tests of blind association, against a list simulator that shares no code with the ground segment."""
