"""A print that ships with the package, planned already: its report, to be looked at before anything is planned."""
