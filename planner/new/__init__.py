"""A new problem file: from answers to a few questions, or from a problem that ships."""
