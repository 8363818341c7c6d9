"""The link to the machine: programs sent to a controller and watched while they run."""
