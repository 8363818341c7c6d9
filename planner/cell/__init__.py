"""The robot cell: robots from their files, kinematics, bodies, and where everything stands."""
