"""The print as beads, from drawings, meshes, faces, waypoints or G-code, and what they require of the nozzle."""
