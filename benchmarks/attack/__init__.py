"""Attacks on purpose: inputs, plans, programs and processes are spoilt at random, and what nobody finds is told.

Each file is one subject: `problems` and `files` spoil what is read, `motions` plans before and after their verification,
`programs` and `extruder` what is written, `kills` and `determinism` whole runs. `cases` runs them, `command` tells.
"""
