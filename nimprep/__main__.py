"""``python -m nimprep`` is the command ``nimprep``."""

from nimprep.cli import main

main(prog_name="nimprep")
