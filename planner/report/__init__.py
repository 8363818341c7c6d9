"""Reports for people: report.html, pictures, plots, and the summary on stdout."""
