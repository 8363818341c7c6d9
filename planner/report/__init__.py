"""What people look at: report.html and a picture."""
