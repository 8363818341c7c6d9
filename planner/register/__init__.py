"""Where the part really is: from places that the nozzle touched to its placement and the uncertainty of that."""
