"""Redundancy resolution: strategies that choose what the nozzle's path leaves free."""
