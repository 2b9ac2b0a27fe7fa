"""Two folders change names at once, where the system can: no moment without either."""

from __future__ import annotations

import ctypes
import errno
import os
import sys
from pathlib import Path

_AT_FDCWD = -100
_RENAME_EXCHANGE = 2
"""From Linux's fcntl.h and fs.h; see renameat2(2)."""

_CANNOT = {errno.ENOSYS, errno.EINVAL, errno.ENOTSUP, errno.EPERM}
"""What a kernel or a file system says that does not know how to."""


def swap_folders(a: Path, b: Path) -> bool:
    """Let two folders of one file system change names; return whether that was possible.

    Where it is not (other systems than Linux, some network file systems), nothing has changed.

    Raises
    ------
    OSError
        One is not there, or must not be renamed.
    """
    if not sys.platform.startswith("linux"):
        return False
    try:
        rename = ctypes.CDLL(None, use_errno=True).renameat2
    except (AttributeError, OSError):
        return False
    if rename(_AT_FDCWD, os.fsencode(a), _AT_FDCWD, os.fsencode(b), _RENAME_EXCHANGE) == 0:
        return True
    number = ctypes.get_errno()
    if number in _CANNOT:
        return False
    raise OSError(number, os.strerror(number), str(a))
