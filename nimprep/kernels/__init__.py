"""Compiled loops, all in this room: arrays in, `out` last, no checks and no I/O.

The public functions above them check and allocate.
"""
