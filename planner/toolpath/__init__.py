"""What is to be printed: from drawings, meshes, faces, waypoints and G-code to beads, and what they ask of the nozzle."""
