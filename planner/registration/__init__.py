"""Where the part really is: from places that the nozzle touched to the placement of the part and its uncertainty."""
