"""Compiled kernels: numba's decorator with a cache that knows of changes everywhere, or without one where none can be
written; and when it compiles."""

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

array_at: Any = np_carray  # in a kernel: the array of a shape at a pointer, in C's order

SECONDS_A_KERNEL = 0.5  # of compiling, on two cores of a server of 2024: some 250 kernels take two minutes
WORTH_TELLING = 10  # kernels: fewer are there in a few seconds


# A division by zero gives what it gives in NumPy, kernels let other threads run, and what they compile is kept on disk.
# That all have the same options spares a tenth of all compiling: numba compiles its own functions for each set of them.
_OPTIONS: dict[str, Any] = {"error_model": "numpy", "nogil": True, "boundscheck": None, "no_cfunc_wrapper": True}


def njit(function: Callable[..., Any] | None = None, **options: Any) -> Any:
    """As `numba.njit` with a cache; where numba finds no folder for it, the kernel is compiled without, and that is told.

    numba looks in the folder NUMBA_CACHE_DIR, beside the sources, and in the user's cache folder. What it finds there is
    used if nothing has changed that the kernel is made of: numba by itself looks at the kernel's own file alone, and goes
    on with old code of kernels and constants of other files.
    """
    if function is None:
        return partial(njit, **options)
    return _cached(numba.njit(**_OPTIONS, **options)(function))


def inner_njit(function: Callable[..., Any] | None = None, **options: Any) -> Any:
    """As `njit`, for kernels that only other kernels call.

    They lack the code by which Python calls a kernel, which would be compiled with them, and again with each kernel that
    calls them. Called from Python all the same, as tests do, they go through a kernel that is compiled for that each time.
    """
    if function is None:
        return partial(inner_njit, **options)
    targetoptions = {**_OPTIONS, "nopython": True, "no_cpython_wrapper": True, **options}
    return _cached(_InnerDispatcher(function, targetoptions=targetoptions))


class _InnerDispatcher(CPUDispatcher):  # type: ignore[misc]
    """A kernel without what Python calls it by."""

    def __call__(self, *arguments: Any) -> Any:
        return _callable(self)(*arguments)


@cache
def _callable(kernel: Any) -> Any:
    """A kernel that calls another one."""

    @numba.njit
    def call(*arguments: Any) -> Any:
        return kernel(*arguments)

    return call


def _cached(kernel: Any) -> Any:
    """The kernel, which keeps on disk what it compiles, where it can."""
    try:
        kernel.enable_caching()
        _stamp(kernel._cache, kernel.py_func)
    except RuntimeError as error:
        if "no locator available" not in str(error):
            raise
        _tell_once()
    return kernel


_stamps: dict[str, str] = {}  # of each module with kernels, by its name


def _stamp(cached: Any, function: Any) -> None:
    """Have the cached code of a function count for just this content of all that it is made of.

    As its version, which numba looks at first: what was written before a class was renamed cannot even be read.
    """
    cached._cache_file._version = f"{numba.__version__} {_stamp_of(function)}"  # numba has no public way
    cached._cache_file._source_stamp = ""  # of the file's time, which a checkout changes


def _stamp_of(function: Any) -> str:
    """Digest of a module's file, of the constants and kernels that it imports, which stand above its first kernel, and of
    the files of the tuples' types."""
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
# Kernels behind addresses: what calls them holds none of their code, so that they are compiled, and loaded, only where
# somebody asks for their address. A call costs nanoseconds, but nothing is inlined.


@cache
def address_of(function: Callable[..., None], signature: str) -> int:
    """The address in this process of a function compiled for C, whose signature is of numbers and pointers, as in
    `void(CPointer(float64), int64)`; what it is made of is cached as of `njit`. Not to be handed to other processes."""
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


_held: list[Any] = []  # their code goes with them


def _call_at(typing: Any, address: Any, arguments: Any) -> Any:
    """In a kernel: call the function at an address with a tuple of numbers, and of arrays in C's order, which it gets as
    pointers to their first numbers."""
    if any(isinstance(each, types.Array) and each.layout != "C" for each in arguments):
        raise errors.TypingError("arrays behind an address have to be in C's order")

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
# How long it takes.


def compile_sparingly() -> None:
    """From now on in this process a kernel that another process compiles is waited for, and loaded; numba by itself would
    compile it beside that. And options of kernels are compared quickly."""
    compare_options_quickly()
    if sys.platform != "win32":
        Dispatcher.compile = _compile_in_turn  # type: ignore[method-assign]


_compile = Dispatcher.compile
_locked: set[str] = set()  # by this process: a kernel that is compiled may ask for itself again


def _compile_in_turn(self: Any, sig: Any) -> Any:
    kept = getattr(self._cache, "_impl", None)  # numba's own functions are kept nowhere
    if kept is None or sig in self.overloads:
        return _compile(self, sig)
    kept.locator.ensure_cache_path()
    path = f"{kept.locator.get_cache_path()}/{kept.filename_base}.lock"
    with global_compiler_lock:  # first, so that no thread waits for the file while another one needs this
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
                    fcntl.flock(file, fcntl.LOCK_UN)  # a process that was forked meanwhile has the file open, too


def compare_options_quickly() -> None:
    """From now on in this process numba compares the options of kernels by those that were set.

    By itself it reads all of them, on both sides, each time that it looks for code of its own functions that it has compiled
    already, which takes a tenth of all compiling. What is equal stays so. Other releases, which keep options otherwise, are
    left as they are.
    """
    if "_values" in getattr(TargetConfig, "__slots__", ()):
        setattr(TargetConfig, "__eq__", _same_options)  # noqa: B010 (mypy lets no method be assigned)
        setattr(TargetConfig, "__hash__", _hash_of_options)  # noqa: B010


def _same_options(one: Any, other: Any) -> Any:
    if type(one) is not type(other):
        return NotImplemented
    return one is other or one._values == other._values or _changed(one) == _changed(other)


def _changed(options: Any) -> dict[str, Any]:
    """Options that were set to something else than they are by themselves."""
    return {name: value for name, value in options._values.items() if value != options.options[name].default}


def _hash_of_options(options: Any) -> int:
    kind: Any = type(options)
    return _hash_of_names(kind)


@cache
def _hash_of_names(kind: Any) -> int:
    """numba's own: of the names of all options, so that what it has looked up before is still found."""
    return hash(tuple(sorted(kind.options)))


# ----------------------------------------------------------------------------------------------------
# What is told.


@cache
def _tell_once() -> None:
    print(
        "note: no cache folder can be written, so kernels are compiled anew each time; "
        "set NUMBA_CACHE_DIR to a folder that can",
        file=sys.stderr,
    )


@contextmanager
def while_compiling(begun: Callable[[int, float], Callable[[int], None]]) -> Iterator[None]:
    """In the block, tell when kernels begin to be compiled that were not found in numba's cache.

    begun: told how many kernels there are to compile, and about how long that takes [s]; what it returns is told after each
    kernel how many of them are there, those of other processes too. It is not told of a few, and once by all processes
    that are forked in the block. What is compiled comes sooner, see `compile_sparingly`.
    """
    compile_sparingly()
    with event.install_listener("numba:compile", _Listener(begun)):
        yield


@contextmanager
def counting_compiled() -> Iterator[Callable[[], int]]:
    """In the block, what tells how many kernels of ours were compiled since it began."""
    counter = _Counter()
    with event.install_listener("numba:compile", counter):
        yield lambda: counter.count


class _Counter(event.Listener):
    """Counts the kernels of ours that are compiled."""

    count = 0

    def on_start(self, event: Any) -> None:
        self.count += _is_ours(event.data["dispatcher"])

    def on_end(self, event: Any) -> None:
        pass


class _Listener(event.Listener):
    """Calls `begun` at the first kernel of ours that is compiled, and what that returns after every one."""

    def __init__(self, begun: Callable[[int, float], Callable[[int], None]]) -> None:
        self._begun = begun
        self._told: Callable[[int], None] | None = None
        self._missing: list[Any] = []
        self._count = self._compiled = 0
        self._said = Value("b", 0)  # by any process that was forked from this one

    def on_start(self, event: Any) -> None:
        if self._told is None and _is_ours(event.data["dispatcher"]):
            self._missing = _not_there()
            self._count = count = len(self._missing)
            with self._said.get_lock():
                first, self._said.value = not self._said.value, 1
            worth = first and count >= WORTH_TELLING
            self._told = self._begun(count, count * SECONDS_A_KERNEL) if worth else lambda _: None

    def on_end(self, event: Any) -> None:
        if self._told is not None and _is_ours(event.data["dispatcher"]):
            self._compiled += 1
            self._missing = [kernel for kernel in self._missing if not was_compiled(kernel)]
            self._told(max(self._compiled, self._count - len(self._missing)))


def was_compiled(kernel: Any) -> bool:
    """Whether numba's cache has a kernel of what it is made of now, for whatever types."""
    file = getattr(getattr(kernel, "_cache", None), "_cache_file", None)
    return file is not None and bool(file._load_index())  # which is empty where it is of something else, see `_stamp`


def _not_there() -> list[Any]:
    """Kernels of the modules that are loaded of which numba's cache has nothing."""
    modules = [module for name, module in list(sys.modules.items()) if name.startswith("planner.")]
    kernels = {id(value): value for module in modules for value in vars(module).values() if _is_ours(value)}
    return [kernel for kernel in kernels.values() if not was_compiled(kernel)]


def _is_ours(value: Any) -> bool:
    function = getattr(value, "py_func", None)
    return getattr(function, "__module__", "").startswith("planner.") and function.__module__ != __name__
