"""Scale and misalignment of the axes of a gyroscope, from turns, rests and references."""
