"""`onboard.tracker`: detection over several frames; `joint` and `joint_and_stack` know the order of their steps, `none` is the chain without one."""
