"""Written programs through parsers and interpreters of other people, which install from package registries."""
