"""Where the part really is: from places that the nozzle touched to its placement and how sure that is."""
