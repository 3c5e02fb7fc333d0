"""Surveys: months of the mission at the level of measurements, with a response that the pixel chain has shown once."""
