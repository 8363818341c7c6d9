"""Player of programs: poses and joints over time, and what it switches, sends and waits for."""
