"""List robots, and add one: its file from a published URDF, and a trial print."""
