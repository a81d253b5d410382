"""Hostile inputs by what they are for: each case writes one, and names the command that reads it.

`case` says what a case is, `wholes` makes the undamaged inputs, `process` runs a command and judges it.
"""
