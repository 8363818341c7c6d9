"""Travel between beads, from state to state: jerk-limited, clear of the part, as quick as possible."""
