"""G-code of the extruder's own board, in time with the robot: written, and read back."""
