"""From joint paths to one sampled trajectory: timing, travel, extrusion, and the dips that are left."""
