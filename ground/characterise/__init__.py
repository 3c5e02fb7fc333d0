"""What an object's light says of it: reduced magnitudes, phase function, period with its false-alarm probability, class."""
