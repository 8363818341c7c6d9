"""G-code for machines with five or six axes: inverse kinematics, writer, reader, and check against the plan."""
