"""Feedback from robots and prints: limits identified from recordings, programs and layers corrected by measurement."""
