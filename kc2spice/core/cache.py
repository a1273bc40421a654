"""Expensive results on disk, found again by a hash of everything that they depend on.

An entry is the hex SHA-256 of an ``.npz`` archive followed by the archive: arrays without pickle
and one JSON text with the structure around them. It is written to a temporary name and renamed, so
readers see whole entries only; a damaged one is noticed by its checksum and built again.
"""

from __future__ import annotations

import atexit
import contextlib
import hashlib
import importlib.metadata
import importlib.util
import io
import json
import os
import shutil
import sys
import tempfile
import time
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import fields, is_dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any, TypeVar, cast

import numpy as np

from kc2spice.core.foreign import read_bounded

T = TypeVar("T")
MAX_TOTAL_BYTES = 2_000_000_000
_ABANDONED = 3600.0  # s
_LIBRARIES = ("numpy", "scipy", "scikit-fem", "gmsh")


def cache_dir() -> Path:
    """``$KC2SPICE_CACHE``, else the platform's directory for files that can be made again."""
    chosen = os.environ.get("KC2SPICE_CACHE")
    if chosen:
        return Path(chosen)
    if sys.platform == "win32":
        base = Path(os.environ.get("LOCALAPPDATA") or _home() / "AppData" / "Local")
    elif sys.platform == "darwin":
        base = _home() / "Library" / "Caches"
    else:
        base = Path(os.environ.get("XDG_CACHE_HOME") or _home() / ".cache")
    return base / "kc2spice"


@lru_cache(maxsize=1)
def _home() -> Path:
    """The user's home; a directory for this process alone where the user has none, as an unknown
    uid in a container: a name in the common temporary directory could be somebody else's.
    """
    try:
        return Path.home()
    except RuntimeError:
        made = tempfile.mkdtemp(prefix="kc2spice-")
        atexit.register(shutil.rmtree, made, ignore_errors=True)
        return Path(made)


def cached(
    kind: str,
    key: Mapping[str, Any],
    build: Callable[[], T],
    *,
    classes: Iterable[type] = (),
    sources: Iterable[str] = (),
) -> tuple[T, bool]:
    """Return ``(result, hit)``: the stored result of an earlier ``build()``, else a new one.

    Parameters
    ----------
    kind : sub-directory for this sort of result.
    key : what the result depends on: scene sections, numbers, strings, lists, mappings.
    build : makes the result: dataclasses, arrays, tuples, lists, dicts with string
        keys, numbers, strings, None, nested at will.
    classes : dataclasses that may occur in the result; no other class is ever restored.
    sources : modules or packages of kc2spice whose source text the result depends on; those of
        ``classes`` are added.

    A directory that cannot be written costs the time of a new build, with a warning, never a
    failure. Whoever asks for what another process is building waits for it.
    """
    known = {cls.__name__: cls for cls in classes}
    modules = {*sources, *(cls.__module__ for cls in known.values())}
    path = cache_dir() / kind / f"{_digest(key, modules)}.entry"
    found, result = _load(path, known)
    if found:
        return cast(T, result), True
    with _alone(path):
        if path.exists():  # somebody else has built it since
            found, result = _load(path, known)
            if found:
                return cast(T, result), True
        result = build()
        try:
            _store(path, _archive(result, known))
        except OSError as error:
            warnings.warn(f"cannot write the cache {cache_dir()}: {error.strerror}", stacklevel=2)
    return result, False


@contextmanager
def _alone(path: Path) -> Iterator[None]:
    """Nobody else builds the same entry meanwhile.

    Where there are no locks, two may build it, which costs time only.
    """
    try:
        import fcntl

        path.parent.mkdir(parents=True, exist_ok=True)
        lock = path.with_name(f".{path.stem}.lock.part")  # cleared away as any other .part
        handle = os.open(lock, os.O_CREAT | os.O_RDWR, 0o600)
    except (ImportError, OSError):
        yield
        return
    try:
        with contextlib.suppress(OSError):
            fcntl.flock(handle, fcntl.LOCK_EX)
        yield
    finally:
        lock.unlink(missing_ok=True)
        with contextlib.suppress(OSError):
            fcntl.flock(handle, fcntl.LOCK_UN)  # a fork may have inherited the handle
        os.close(handle)


def _digest(key: Mapping[str, Any], sources: Iterable[str]) -> str:
    versions = {name: _version(name) for name in _LIBRARIES}
    texts = {name: _source_digest(name) for name in sources}
    content = {"key": key, "libraries": versions, "sources": texts}
    text = json.dumps(content, sort_keys=True, default=_plain)
    return hashlib.sha256(text.encode()).hexdigest()[:40]


def _version(library: str) -> str:
    try:
        return importlib.metadata.version(library)
    except importlib.metadata.PackageNotFoundError:
        return "absent"


def _plain(value: Any) -> Any:
    """JSON form of what a key may hold besides JSON: scene sections and numpy scalars."""
    if hasattr(value, "model_dump"):
        return value.model_dump(mode="json")
    if isinstance(value, np.generic):
        return value.item()
    raise TypeError(f"{type(value).__name__} cannot be part of a cache key")


def _source_digest(module: str) -> str:
    """Hash of a module's text, or of all modules of a package; never the same twice for one that
    has no file, such as a notebook's."""
    loaded = sys.modules.get(module)
    file: str | None
    if loaded is None:
        spec = importlib.util.find_spec(module)
        if spec is None or spec.origin is None:
            raise ModuleNotFoundError(module)
        file, package = spec.origin, spec.submodule_search_locations is not None
    else:
        file, package = getattr(loaded, "__file__", None), hasattr(loaded, "__path__")
    if file is None:
        return os.urandom(16).hex()
    origin = Path(file)
    files = sorted(origin.parent.rglob("*.py")) if package else [origin]
    digest = hashlib.sha256()
    for path in files:
        digest.update(path.read_bytes())
    return digest.hexdigest()


def _archive(result: Any, known: Mapping[str, type]) -> bytes:
    arrays: dict[str, np.ndarray] = {}
    structure = json.dumps(_encode(result, arrays, known))
    buffer = io.BytesIO()
    np.savez(buffer, structure=np.array(structure), **arrays)  # type: ignore[arg-type]
    return buffer.getvalue()


def _store(path: Path, archive: bytes) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    handle, temporary = tempfile.mkstemp(dir=path.parent, prefix=".", suffix=".part")
    try:
        with os.fdopen(handle, "wb") as file:
            file.write(hashlib.sha256(archive).hexdigest().encode() + archive)
        os.replace(temporary, path)
    except BaseException:
        Path(temporary).unlink(missing_ok=True)
        raise
    _prune(cache_dir())


def _prune(root: Path) -> None:
    """Drop the entries that were unused for longest once the cache is larger than its limit.

    What a killed process left half written goes after an hour.
    """
    for part in root.glob("*/.*.part"):
        with contextlib.suppress(OSError):  # another process may have finished or dropped it
            if time.time() - part.stat().st_mtime > _ABANDONED:
                part.unlink()
    entries = [(entry, entry.stat()) for entry in root.glob("*/*.entry")]
    total = sum(stat.st_size for _, stat in entries)
    for entry, stat in sorted(entries, key=lambda pair: pair[1].st_mtime):
        if total <= MAX_TOTAL_BYTES:
            return
        entry.unlink(missing_ok=True)
        total -= stat.st_size


def _load(path: Path, known: Mapping[str, type]) -> tuple[bool, Any]:
    try:
        content = read_bounded(path, MAX_TOTAL_BYTES)
    except OSError:
        return False, None
    checksum, archive = content[:64], content[64:]
    if hashlib.sha256(archive).hexdigest().encode() != checksum:
        warnings.warn(f"damaged cache entry {path.name} is built again", stacklevel=3)
        return False, None
    try:
        with np.load(io.BytesIO(archive), allow_pickle=False) as arrays:
            structure = json.loads(str(arrays["structure"]))
            result = _decode(structure, arrays, known)
    except Exception as error:  # the sum is right, but nobody here wrote this
        warnings.warn(f"cache entry {path.name} is not ours: {error}", stacklevel=3)
        return False, None
    with contextlib.suppress(OSError):  # a read-only cache serves as well
        os.utime(path)  # keeps it from being pruned
    return True, result


def _encode(value: Any, arrays: dict[str, np.ndarray], known: Mapping[str, type]) -> Any:
    """JSON structure of ``value``: ``[tag, ...]`` lists, with arrays set aside by number."""
    if value is None or isinstance(value, (bool, int, float, str)):
        return ["plain", value.item() if isinstance(value, np.generic) else value]
    if isinstance(value, np.generic):
        return ["plain", value.item()]
    if isinstance(value, np.ndarray):
        name = f"a{len(arrays)}"
        arrays[name] = value
        return ["array", name]
    if is_dataclass(value) and known.get(type(value).__name__) is type(value):
        content = {item.name: getattr(value, item.name) for item in fields(value)}
        return ["class", type(value).__name__, _encode(content, arrays, known)]
    if isinstance(value, Mapping):
        return ["dict", {name: _encode(item, arrays, known) for name, item in value.items()}]
    if isinstance(value, (tuple, list)):
        return [type(value).__name__, [_encode(item, arrays, known) for item in value]]
    raise TypeError(f"{type(value).__name__} cannot be cached; name it in classes")


def _decode(node: Any, arrays: Mapping[str, np.ndarray], known: Mapping[str, type]) -> Any:
    tag, *content = node
    if tag == "plain":
        return content[0]
    if tag == "array":
        return arrays[content[0]]
    if tag == "class":
        return known[content[0]](**_decode(content[1], arrays, known))
    if tag == "dict":
        return {name: _decode(item, arrays, known) for name, item in content[0].items()}
    items = [_decode(item, arrays, known) for item in content[0]]
    return tuple(items) if tag == "tuple" else items
