"""References that are generated: schemas of files for editors, and pages of every field, metric and command."""
