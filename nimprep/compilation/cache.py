"""What was compiled, one file for each kernel and signature; what is damaged or old is not read.

Numba's own cache wants a folder to write to before it reads, trusts every byte that it finds, and
knows of a kernel's own file only, not of those it takes constants and helpers from.

A file is the SHA-256 of everything that what was compiled depends on, the SHA-256 of what follows,
and Numba's pickle. So nothing is unpickled that this program did not write whole, and what fits no
more is written over.
"""

from __future__ import annotations

import hashlib
import os
import pickle
import re
import secrets
import sys
from collections.abc import Callable
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import Any

import llvmlite
import numba
import numpy as np
from numba.core import compiler, serialize, sigutils

from nimprep.compilation.folders import FOLDERS

_DIGEST = 32

# What Numba ships of types says nothing of these.
_config: Any = numba.config
_compiler: Any = compiler
_serialize: Any = serialize
_sigutils: Any = sigutils

_IMPORT = re.compile(rb"^from (nimprep\.[\w.]+) import ", re.MULTILINE)


class KernelCache:
    """Find and keep one kernel's compiled signatures, where a Numba dispatcher asks for them.

    Numba holds its lock meanwhile, so that no two threads of a process come here at once.

    Attributes
    ----------
    name : str
        Module and name of the kernel.
    loaded, compiled : int
        Signatures that were found, and that were not.
    folders : list of Path or None
        Where each of them is kept; None = nowhere.
    """

    def __init__(self, function: Callable[..., Any], options: str) -> None:
        self.name = f"{function.__module__}.{function.__qualname__}"
        self.loaded = self.compiled = 0
        self.folders: list[Path | None] = []
        self._options = options
        self._sources = code_digest(function.__module__)

    @property
    def cache_path(self) -> str | None:
        """Where it keeps what is compiled; None = nowhere."""
        folder = FOLDERS.to_write
        return None if folder is None else str(folder)

    def load_overload(self, signature: Any, target_context: Any) -> Any:
        """Return what was compiled for a signature, None where there is none."""
        target_context.refresh()
        name, identity = self._key(signature, target_context.codegen())
        for folder in FOLDERS.to_read():
            body = _read(folder / name, identity)
            if body is not None:
                self.loaded += 1
                self.folders.append(folder)
                return _compiler.CompileResult._rebuild(target_context, *pickle.loads(body))
        self.compiled += 1
        return None

    def save_overload(self, signature: Any, result: Any) -> None:
        """Keep what was compiled for a signature, where there is a place for it."""
        folder = FOLDERS.to_write
        if folder is not None:
            name, identity = self._key(signature, result.codegen)
            body = _serialize.dumps(result._reduce())
            try:
                _write(folder / name, identity + hashlib.sha256(body).digest() + body)
            except OSError as error:
                FOLDERS.note_failure(folder / name, error)
                folder = None
        self.folders.append(folder)

    def _key(self, signature: Any, codegen: Any) -> tuple[str, bytes]:
        """Return the file's name, and the digest of all that what was compiled depends on."""
        variant = repr((_sigutils.normalize_signature(signature), codegen.magic_tuple()))
        versions = numba.__version__, llvmlite.__version__, np.__version__, sys.version
        settings = str(_config.OPT), _config.BOUNDSCHECK, _config.DEBUGINFO_DEFAULT
        depends = repr((self.name, variant, versions, settings, self._options, self._sources))
        tag = hashlib.sha256(variant.encode()).hexdigest()[:12]
        name = f"{self.name}.{sys.implementation.cache_tag}-{tag}.nbc"
        return name, hashlib.sha256(depends.encode()).digest()

    def enable(self) -> None:
        """Do nothing: Numba asks for this, nimprep never does."""

    disable = flush = enable


def _read(path: Path, identity: bytes) -> bytes | None:
    try:
        with path.open("rb") as file:
            if file.read(_DIGEST) != identity:
                return None
            digest, body = file.read(_DIGEST), file.read()
    except OSError:
        return None
    return body if hashlib.sha256(body).digest() == digest else None


def _write(path: Path, content: bytes) -> None:
    """Put a file in its place whole, over whatever is there."""
    beside = path.with_name(f"{path.name}.{os.getpid()}-{secrets.token_hex(4)}.tmp")
    try:
        beside.write_bytes(content)
        with suppress(OSError):
            path.rmdir()  # an empty folder of that name, which no file can replace
        beside.replace(path)
    except BaseException:
        with suppress(OSError):
            beside.unlink()
        raise


@cache
def code_digest(module: str) -> str:
    """Return the digest of a module's source and of all of nimprep that it is made from."""
    sources: dict[str, bytes] = {}
    wanted = [module]
    while wanted:
        name = wanted.pop()
        if name not in sources:
            sources[name] = _source(name)
            wanted += [found.decode() for found in _IMPORT.findall(sources[name])]
    return hashlib.sha256(repr(sorted(sources.items())).encode()).hexdigest()


@cache
def _source(module: str) -> bytes:
    # From whoever loaded it, as the package may be in a zip file.
    loader: Any = sys.modules[module].__spec__.loader  # type: ignore[union-attr]
    text: str | None = loader.get_source(module)
    return (text or "").encode()
