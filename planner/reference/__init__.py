"""References that are generated: the schema of files for editors, and pages of every field, metric and command."""
