"""What people look at: report.html, pictures and plots."""
