"""The main job end to end, on simulated data: `make demo`."""
