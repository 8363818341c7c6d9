"""URScript for Universal Robots' controllers: written, and read back."""
