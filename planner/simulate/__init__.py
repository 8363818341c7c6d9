"""Simulators of the hardware of a print: a robot controller and an extruder's board, on this computer's network."""
