"""The robot cell: robots read from their files, kinematics, bodies, and the placement of everything."""
