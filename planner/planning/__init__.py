"""From a problem to a verified plan and its files: the table of contents of the whole process."""
