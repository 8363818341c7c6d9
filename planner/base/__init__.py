"""What every room stands on: errors, array types, processes, results folders, and how commands start."""
