"""From a problem to a verified plan and its files: the table of contents of all that is done."""
