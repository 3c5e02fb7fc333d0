"""`onboard.tracker`: detection over several frames; `joint` knows the order of its steps, `none` is the chain without one."""
