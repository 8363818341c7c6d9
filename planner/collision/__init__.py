"""What is in the way: bodies of robots, tools and fixtures, part and print, and how near a posture brings them."""
