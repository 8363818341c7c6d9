"""The pictures of the concept pages, drawn from the cells and plans that they explain."""
