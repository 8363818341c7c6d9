"""Wings in layers parallel to their surfaces."""
