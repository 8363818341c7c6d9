"""Attacks on purpose: inputs, plans, programs and processes are spoilt at random, and what nobody finds is told.

Each file is one subject: `problems` and `files` spoil what is read, `motions` plans before and after their verification,
`programs` and `extruder` what is written, `recordings`, `tables` and `clouds` what robots, extruders and prints teach,
`kills` and `determinism` whole runs. `cases` runs them, `in_process` commands, `command` tells.
"""
