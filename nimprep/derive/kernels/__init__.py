"""Compiled loops: no checks, no I/O; the public functions above them check and allocate."""
