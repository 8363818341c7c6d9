"""Where to place the part: a map of how well it can be printed at each place, and the best places."""
