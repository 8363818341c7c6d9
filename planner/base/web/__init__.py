"""Pages in the browser, served on this computer only: access, updates to a page, and its requests."""
