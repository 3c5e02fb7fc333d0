"""Pixels to directions and epochs: apparent direction, published direction, epoch of each row."""
