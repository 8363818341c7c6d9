"""G-code of machines with five or six axes: axes from poses, written, read back, and held against the plan."""
