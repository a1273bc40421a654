"""Cache of expensive results on disk; the key of an entry is a hash of all inputs.

An entry is an ``.npz`` archive, without pickle. An entry contains arrays, and one JSON text with
the structure of the result. An entry is written under a temporary name and then renamed, so other
processes read complete entries only. Checksums detect a damaged entry, which is then computed
again.
"""

from __future__ import annotations

import atexit
import contextlib
import hashlib
import importlib.metadata
import importlib.util
import json
import os
import shutil
import sys
import tempfile
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import fields
from functools import cache
from pathlib import Path
from typing import Any, TypeVar, cast

import numpy as np

from kc2spice.core.files import lock_path
from kc2spice.core.untrusted_files import read_archive
from kc2spice.core.user_warnings import warn_user

T = TypeVar("T")
MAX_TOTAL_BYTES = 2_000_000_000
_INCOMPLETE_FILE_AGE = 3600.0  # s, age at which an incomplete file is deleted
_LIBRARIES = ("numpy", "scipy", "scikit-fem", "gmsh")
# Names of the environment variables that contain the cache directory, keyed by platform.
# The second text of each pair is the default cache directory below the user's home directory.
_CACHE_DIRECTORIES = {"win32": ("LOCALAPPDATA", "AppData/Local"), "darwin": ("", "Library/Caches")}


def find_cache_dir() -> Path:
    """Return the cache directory: ``$KC2SPICE_CACHE``, or the default of the platform."""
    if selected := os.environ.get("KC2SPICE_CACHE"):
        return Path(selected)
    variable, below = _CACHE_DIRECTORIES.get(sys.platform, ("XDG_CACHE_HOME", ".cache"))
    return Path(os.environ.get(variable) or _find_home_directory() / below) / "kc2spice"


@cache
def _find_home_directory() -> Path:
    """Return the home directory, or a private temporary one if the user has none.

    A user without an account, as in some containers, has no home directory. The private directory
    has a random name, because a fixed name in the shared temporary directory could belong to
    another user.
    """
    try:
        return Path.home()
    except RuntimeError:
        directory = tempfile.mkdtemp(prefix="kc2spice-")
        atexit.register(shutil.rmtree, directory, ignore_errors=True)
        return Path(directory)


def load_or_build(
    kind: str,
    key: Mapping[str, Any],
    build: Callable[[], T],
    *,
    classes: Iterable[type] = (),
    sources: Iterable[str] = (),
) -> T:
    """Load the result of ``build()`` from the cache, or call ``build()`` and store it.

    Parameters
    ----------
    kind : name of the sub-directory for results of this kind.
    key : values on which the result depends: scene sections, numbers, strings, lists, mappings.
    build : function without arguments that returns the result. The result consists of dataclasses,
        arrays, tuples, dicts with string keys, numbers, strings and None, in any nesting.
    classes : dataclasses that may occur in the result; no other class is ever restored.
    sources : modules or packages of kc2spice on whose source text the result depends, in addition
        to the modules of ``classes``.

    If the cache directory cannot be written, the function calls ``build()`` and prints a warning.
    If another process is building the same entry, the function waits for this process.
    """
    known = {cls.__name__: cls for cls in classes}
    modules = {__name__, *sources, *(cls.__module__ for cls in known.values())}
    path = find_cache_dir() / kind / f"{_compute_digest(key, modules)}.entry"
    entry = _load_entry(path, known)
    if entry is None:
        with _lock_entry(path):
            # another process may have stored the entry while this process waited for the lock
            entry = _load_entry(path, known)
            if entry is None:
                _store_result(path, result := build(), known)
                return result
    return cast(T, entry[0])


@contextmanager
def _lock_entry(path: Path) -> Iterator[None]:
    """Lock a cache entry, so that no other process builds the same entry meanwhile.

    On systems without file locks, other processes can build the same cache entry at the same time.
    """
    lock = path.with_name(f".{path.stem}.lock.part")  # old files with the suffix .part are deleted
    with ExitStack() as stack:
        with contextlib.suppress(OSError):
            path.parent.mkdir(parents=True, exist_ok=True)
            lock.touch(0o600)
            stack.enter_context(lock_path(lock))
            stack.callback(lock.unlink, missing_ok=True)
        yield


def _compute_digest(key: Mapping[str, Any], sources: Iterable[str]) -> str:
    """Compute the SHA-256 hash of a key, of source texts and of versions of libraries."""
    versions = {name: _find_installed_version(name) for name in _LIBRARIES}
    texts = {name: _compute_source_digest(name) for name in sources}
    content = {"key": key, "libraries": versions, "sources": texts}
    text = json.dumps(content, sort_keys=True, default=_convert_to_json)
    return hashlib.sha256(text.encode()).hexdigest()[:40]


@cache
def _find_installed_version(library: str) -> str:
    """Return the installed version of a library, or ``absent``."""
    try:
        return importlib.metadata.version(library)
    except importlib.metadata.PackageNotFoundError:
        return "absent"


def _convert_to_json(value: Any) -> Any:
    """Convert a scene section or a numpy scalar to a JSON value."""
    return value.model_dump(mode="json") if hasattr(value, "model_dump") else value.item()


def _compute_source_digest(module: str) -> str:
    """Compute the hash of the source text of a module, or of all modules of a package.

    A module without a file, such as a notebook, gets a different hash at each call.
    """
    loaded = sys.modules.get(module)
    spec = importlib.util.find_spec(module) if loaded is None else loaded.__spec__
    file = getattr(loaded, "__file__", None) or getattr(spec, "origin", None)
    if loaded is None and file is None:
        raise ModuleNotFoundError(module)
    if file is None:
        return os.urandom(16).hex()
    package = spec is not None and spec.submodule_search_locations is not None
    files = sorted(Path(file).parent.rglob("*.py")) if package else [Path(file)]
    return hashlib.sha256(b"".join(path.read_bytes() for path in files)).hexdigest()


def _store_result(path: Path, result: Any, known: Mapping[str, type]) -> None:
    """Write a result into the cache file at ``path``."""
    arrays: dict[str, np.ndarray] = {}
    structure = json.dumps(_encode_value(result, arrays, known)).encode()
    arrays["structure"] = np.frombuffer(structure, dtype=np.uint8)
    temporary = path.with_name(f".{path.stem}.{os.getpid()}.part")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with temporary.open("wb") as file:
            np.savez(file, **arrays)  # type: ignore[arg-type]
        os.replace(temporary, path)
        _delete_unused_entries(find_cache_dir())
    except OSError as error:
        warn_user(f"the cache {find_cache_dir()} cannot be written: {error.strerror}")
    finally:
        with contextlib.suppress(OSError):
            temporary.unlink()


def _delete_unused_entries(root: Path) -> None:
    """Delete the least recently used entries if the cache exceeds its size limit.

    Files that a killed process left incomplete are deleted after an hour.
    """
    for part in root.glob("*/.*.part"):
        # another process may have renamed or deleted the file
        with contextlib.suppress(OSError):
            if time.time() - part.stat().st_mtime > _INCOMPLETE_FILE_AGE:
                part.unlink()
    entries = [(entry, entry.stat()) for entry in root.glob("*/*.entry")]
    total = sum(stat.st_size for _, stat in entries)
    for entry, stat in sorted(entries, key=lambda pair: pair[1].st_mtime):
        if total <= MAX_TOTAL_BYTES:
            return
        entry.unlink(missing_ok=True)
        total -= stat.st_size


def _load_entry(path: Path, known: Mapping[str, type]) -> tuple[Any] | None:
    """Return the cached result in a tuple of one item; None for an unreadable entry."""
    if not path.exists():
        return None
    try:
        arrays = read_archive(
            path, lambda name: True, entries=lambda name: MAX_TOTAL_BYTES, total=MAX_TOTAL_BYTES
        )
        result = _decode_value(json.loads(arrays["structure"].tobytes()), arrays, known)
    except Exception as error:
        warn_user(f"the cache entry {path.name} is damaged and is computed again: {error}")
        return None
    with contextlib.suppress(OSError):  # a read-only file keeps its modification time
        os.utime(path)  # records the time of the entry's last use
    return (result,)


def _encode_value(value: Any, arrays: dict[str, np.ndarray], known: Mapping[str, type]) -> Any:
    """Convert a value to a JSON structure, and collect its arrays in a mapping.

    A value that JSON cannot represent becomes ``{tag: …}`` with the name of its type as tag.
    """
    if isinstance(value, np.ndarray):
        arrays[name := f"a{len(arrays)}"] = value
        return {"array": name}
    if isinstance(value, (list, tuple)):
        return [_encode_value(item, arrays, known) for item in value]
    tag, content = "dict", value
    if known.get(type(value).__name__) is type(value):
        tag = type(value).__name__
        content = {item.name: getattr(value, item.name) for item in fields(known[tag])}
    if isinstance(content, Mapping):
        return {tag: {name: _encode_value(item, arrays, known) for name, item in content.items()}}
    return value.item() if isinstance(value, np.generic) else value


def _decode_value(node: Any, arrays: Mapping[str, np.ndarray], known: Mapping[str, type]) -> Any:
    """Restore a value from its JSON structure and the arrays of the cache entry."""
    if isinstance(node, list):
        return tuple(_decode_value(item, arrays, known) for item in node)
    if not isinstance(node, dict):
        return node
    ((tag, content),) = node.items()
    if tag == "array":
        return arrays[content]
    result = {name: _decode_value(item, arrays, known) for name, item in content.items()}
    return result if tag == "dict" else known[tag](**result)
