"""Figures of quality and speed, on data that is made on the spot."""
