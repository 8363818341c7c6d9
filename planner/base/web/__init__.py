"""Pages in the browser, served on this computer only: who is let in, what pages are told, and what they ask for."""
