"""What robots and prints teach: limits identified from recordings, programs and layers corrected by what was executed and printed."""
