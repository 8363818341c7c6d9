"""Simulators of what a print runs on: a robot's controller and an extruder's board, on the network of this computer."""
