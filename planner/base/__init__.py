"""Used by all other packages: errors, array types, processes, results folders, and how commands start."""
