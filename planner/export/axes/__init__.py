"""G-code of machines with five or six axes: inverse kinematics, writer, reader, and check against the plan."""
