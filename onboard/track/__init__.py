"""`onboard.tracker`: detection over several frames; `joint`, `joint_and_stack` know the order of their steps; `none` has none."""
