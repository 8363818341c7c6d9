"""Compiled kernels: numba's decorator with a cache that notices changes in other files, too; reports on compilation.

Where no cache can be written, kernels are compiled without one.
"""

from __future__ import annotations

import hashlib
import inspect
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import cache, partial
from multiprocessing import Value
from pathlib import Path
from typing import Any

import numba
import numpy as np
from llvmlite import ir
from numba import carray as np_carray  # type: ignore[attr-defined]
from numba.core import errors, event, sigutils, types
from numba.core.ccallback import CFunc
from numba.core.compiler_lock import global_compiler_lock
from numba.core.dispatcher import Dispatcher
from numba.core.registry import CPUDispatcher
from numba.core.targetconfig import TargetConfig
from numba.extending import intrinsic

if sys.platform != "win32":
    import fcntl

array_at: Any = np_carray  # in a kernel: the C-ordered array of a given shape at a pointer

SECONDS_A_KERNEL = 0.3  # s to wait per kernel on two ordinary cores; on a 2024 server 320 kernels take 65 s
WORTH_TELLING = 10  # kernels: fewer compile within a few seconds


# Division by zero behaves as in NumPy, and kernels release the GIL. One set of options for all of them saves a tenth of
# all compiling: numba compiles its own functions once per set.
_OPTIONS: dict[str, Any] = {"error_model": "numpy", "nogil": True, "boundscheck": None, "no_cfunc_wrapper": True}


def njit(function: Callable[..., Any] | None = None, **options: Any) -> Any:
    """As `numba.njit` with a cache; where numba finds no folder for it, the kernel is compiled uncached, with a note.

    numba looks in the folder NUMBA_CACHE_DIR, next to the sources, and in the user's cache folder. Cached code is used
    only if nothing the kernel depends on has changed: numba itself checks the kernel's own file alone, and would go on
    using outdated kernels and constants from other files.
    """
    if function is None:
        return partial(njit, **options)
    return _cached(numba.njit(**_OPTIONS, **options)(function))


def inner_njit(function: Callable[..., Any] | None = None, **options: Any) -> Any:
    """As `njit`, for kernels that only other kernels call.

    They have no Python wrapper, which would be compiled with them and again with each kernel that calls them. If Python
    calls them all the same, as tests do, a kernel that calls them is compiled for it in each process.
    """
    if function is None:
        return partial(inner_njit, **options)
    targetoptions = {**_OPTIONS, "nopython": True, "no_cpython_wrapper": True, **options}
    return _cached(_InnerDispatcher(function, targetoptions=targetoptions))


class _InnerDispatcher(CPUDispatcher):  # type: ignore[misc]
    """A kernel without a Python wrapper."""

    def __call__(self, *arguments: Any) -> Any:
        return _callable(self)(*arguments)


@cache
def _callable(kernel: Any) -> Any:
    """A kernel that calls another one, for use from Python."""

    @numba.njit
    def call(*arguments: Any) -> Any:
        return kernel(*arguments)

    return call


def _cached(kernel: Any) -> Any:
    """The kernel, its compiled code cached on disk where possible."""
    try:
        kernel.enable_caching()
        _stamp(kernel._cache, kernel.py_func)
    except RuntimeError as error:
        if "no locator available" not in str(error):
            raise
        _tell_once()
    return kernel


_stamps: dict[str, str] = {}  # by name, of modules with kernels


def _stamp(cached: Any, function: Any) -> None:
    """Tie the cached code of a function to the present content of everything it depends on.

    The stamp is stored as the version, which numba checks first: code cached before a class was renamed cannot be read.
    """
    cached._cache_file._version = f"{numba.__version__} {_stamp_of(function)}"  # numba has no public API for it
    cached._cache_file._source_stamp = ""  # else the file's time, which a checkout changes


def _stamp_of(function: Any) -> str:
    """Digest of a module's file, the constants and kernels imported above its first kernel, and the files that define
    its named tuples."""
    module = function.__module__
    if module not in _stamps:
        digest = hashlib.blake2b(Path(function.__code__.co_filename).read_bytes(), digest_size=16)
        for name, value in sorted(function.__globals__.items()):
            if isinstance(value, bool | int | float | tuple):
                digest.update(f"{name} {value!r}".encode())
            elif isinstance(value, np.ndarray):
                digest.update(value.tobytes())
            elif isinstance(value, type) and hasattr(value, "_fields"):
                digest.update(Path(inspect.getfile(value)).read_bytes())
            elif getattr(value, "py_func", function).__module__ != module:
                digest.update(_stamp_of(value.py_func).encode())
        _stamps[module] = digest.hexdigest()
    return _stamps[module]


# ----------------------------------------------------------------------------------------------------
# Kernels called by address: their callers contain none of their code, so they are compiled and loaded only where their
# address is requested. A call costs nanoseconds, but nothing is inlined.


@cache
def address_of(function: Callable[..., None], signature: str) -> int:
    """The address of a function compiled for C, cached as with `njit`; valid in this process only.

    Its signature consists of numbers and pointers, as in `void(CPointer(float64), int64)`.
    """
    compiled: Any = CFunc(
        function, sigutils.normalize_signature(signature), locals={}, options={"error_model": "numpy"}
    )
    try:
        compiled.enable_caching()
        _stamp(compiled._cache, function)
    except RuntimeError as error:
        if "no locator available" not in str(error):
            raise
        _tell_once()
    compiled.compile()
    _held.append(compiled)
    return int(compiled.address)


_held: list[Any] = []  # keeps compiled functions alive: their code would be freed with them


def _call_at(typing: Any, address: Any, arguments: Any) -> Any:
    """In a kernel: call the function at an address with a tuple of numbers and C-ordered arrays, which are passed as
    pointers to their first elements."""
    if any(isinstance(each, types.Array) and each.layout != "C" for each in arguments):
        raise errors.TypingError("arrays passed by address must be in C order")

    def lower(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        handed = []
        for k, each in enumerate(arguments):
            value = builder.extract_value(values[1], k)
            handed.append(
                context.make_array(each)(context, builder, value).data if isinstance(each, types.Array) else value
            )
        function = ir.FunctionType(ir.VoidType(), [value.type for value in handed])
        builder.call(builder.inttoptr(values[0], function.as_pointer()), handed)
        return context.get_dummy_value()

    return types.void(types.intp, arguments), lower


call_at: Any = intrinsic(_call_at)


# ----------------------------------------------------------------------------------------------------
# Compile time.


def compile_sparingly() -> None:
    """From now on, this process waits for a kernel that another one is compiling, and loads it.

    numba by itself would compile it a second time. Kernel options are compared quickly as well.
    """
    compare_options_quickly()
    if sys.platform != "win32":
        Dispatcher.compile = _compile_in_turn  # type: ignore[method-assign]


_compile = Dispatcher.compile
_locked: set[str] = set()  # files locked by this process: compiling a kernel may request that very kernel again


def _compile_in_turn(self: Any, sig: Any) -> Any:
    kept = getattr(self._cache, "_impl", None)  # numba's own functions are not cached
    if kept is None or sig in self.overloads:
        return _compile(self, sig)
    kept.locator.ensure_cache_path()
    path = f"{kept.locator.get_cache_path()}/{kept.filename_base}.lock"
    with global_compiler_lock:  # first, so that no thread waits for the file lock while another needs this one
        if path in _locked:
            return _compile(self, sig)
        with open(path, "w", encoding="utf-8") as file:
            with suppress(OSError):  # a file system without locks
                fcntl.flock(file, fcntl.LOCK_EX)
            _locked.add(path)
            try:
                return _compile(self, sig)
            finally:
                _locked.discard(path)
                with suppress(OSError):
                    fcntl.flock(file, fcntl.LOCK_UN)  # a process forked meanwhile has the file open, too


def compare_options_quickly() -> None:
    """From now on in this process, numba compares kernels by the options that were set.

    By itself it reads all options on both sides whenever it looks up compiled code of its own functions, which takes a
    tenth of all compile time. The results of comparisons do not change. Releases of numba that store options in another
    way are left as they are.
    """
    if "_values" in getattr(TargetConfig, "__slots__", ()):
        setattr(TargetConfig, "__eq__", _same_options)  # noqa: B010 (mypy lets no method be assigned)
        setattr(TargetConfig, "__hash__", _hash_of_options)  # noqa: B010


def _same_options(one: Any, other: Any) -> Any:
    if type(one) is not type(other):
        return NotImplemented
    return one is other or one._values == other._values or _changed(one) == _changed(other)


def _changed(options: Any) -> dict[str, Any]:
    """Options set to something other than their default."""
    return {name: value for name, value in options._values.items() if value != options.options[name].default}


def _hash_of_options(options: Any) -> int:
    kind: Any = type(options)
    return _hash_of_names(kind)


@cache
def _hash_of_names(kind: Any) -> int:
    """numba's own hash, of the names of all options, so that entries hashed before are still found."""
    return hash(tuple(sorted(kind.options)))


# ----------------------------------------------------------------------------------------------------
# Reports.


@cache
def _tell_once() -> None:
    print(
        "note: no cache folder is writable, so kernels are compiled again in every run; "
        "set NUMBA_CACHE_DIR to a writable folder",
        file=sys.stderr,
    )


@contextmanager
def while_compiling(begun: Callable[[int, float], Callable[[int], None]]) -> Iterator[None]:
    """In the block, report when kernels that are not in numba's cache start to be compiled.

    begun: called with the number of kernels to compile and roughly how long that takes [s]; what it returns is called
    after each kernel with how many are done, including those of other processes. It is not called for a few kernels,
    and only once by all processes forked in the block. Compiling is faster in it, too, see `compile_sparingly`.
    """
    compile_sparingly()
    with event.install_listener("numba:compile", _Listener(begun)):
        yield


@contextmanager
def counting_compiled() -> Iterator[Callable[[], int]]:
    """Yields a function that returns how many of our kernels were compiled since the block began."""
    counter = _Counter()
    with event.install_listener("numba:compile", counter):
        yield lambda: counter.count


class _Counter(event.Listener):
    """Counts our kernels as they are compiled."""

    count = 0

    def on_start(self, event: Any) -> None:
        self.count += _is_ours(event.data["dispatcher"])

    def on_end(self, event: Any) -> None:
        pass


class _Listener(event.Listener):
    """Calls `begun` when our kernels begin to be compiled, and what that returns after every one."""

    def __init__(self, begun: Callable[[int, float], Callable[[int], None]]) -> None:
        self._begun = begun
        self._told: Callable[[int], None] | None = None
        self._missing: list[Any] = []
        self._count = self._compiled = 0
        self._most = False
        self._said = Value("b", 0)  # shared with processes forked from this one

    def on_start(self, event: Any) -> None:
        if self._told is not None or not _is_ours(event.data["dispatcher"]):
            return
        if not self._missing:
            kernels = _loaded_kernels()
            self._missing = [kernel for kernel in kernels if not was_compiled(kernel)]
            self._count, self._most = len(self._missing), 2 * len(self._missing) > len(kernels)
        # If most kernels are there, this run may need few of the others: it is told only when it has compiled some.
        if self._most or self._compiled >= WORTH_TELLING:
            with self._said.get_lock():
                first, self._said.value = not self._said.value, 1
            worth = first and self._count >= WORTH_TELLING
            self._told = self._begun(self._count, self._count * SECONDS_A_KERNEL) if worth else lambda _: None

    def on_end(self, event: Any) -> None:
        if _is_ours(event.data["dispatcher"]):
            self._compiled += 1
            if self._told is not None:
                self._missing = [kernel for kernel in self._missing if not was_compiled(kernel)]
                self._told(max(self._compiled, self._count - len(self._missing)))


def was_compiled(kernel: Any) -> bool:
    """Whether numba's cache holds a kernel in its present state, for any types."""
    file = getattr(getattr(kernel, "_cache", None), "_cache_file", None)
    return file is not None and bool(file._load_index())  # empty where the stamp differs, see `_stamp`


def _loaded_kernels() -> list[Any]:
    """Our kernels of the modules that are loaded."""
    modules = [module for name, module in list(sys.modules.items()) if name.startswith("planner.")]
    return list({id(value): value for module in modules for value in vars(module).values() if _is_ours(value)}.values())


def _is_ours(value: Any) -> bool:
    function = getattr(value, "py_func", None)
    return getattr(function, "__module__", "").startswith("planner.") and function.__module__ != __name__
