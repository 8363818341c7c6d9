"""Where the part should stand: a map of how well it can be printed from each place, and the best places."""
