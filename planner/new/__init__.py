"""A problem file of one's own: from answers to a few questions, or from a problem that ships."""
