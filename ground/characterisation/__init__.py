"""What an object is, from its light over passes: period, amplitude, phase law and class.

`passes` brings magnitudes to a standard distance and phase, `period` finds the period that all passes share, `phase_law` how the
light falls with the phase angle, and `judge` says stable, tumbling or glinting.
"""
