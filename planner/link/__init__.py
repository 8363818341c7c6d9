"""The link to the machine: sends programs to a controller and monitors them while they run."""
