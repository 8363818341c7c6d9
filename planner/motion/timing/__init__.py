"""Timing of a bead: the commanded speed wherever joint limits allow it, and minimal dips."""
