"""One robot: its file, the URDF that it names, its bodies, and what comes of them all."""
